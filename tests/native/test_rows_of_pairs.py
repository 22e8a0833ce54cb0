"""Where convex shapes touch: rows are MuJoCo's in most poses, and what lies on something rests as it does in MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .rows_of_pairs import PAIRS, shares

LEAST = {("cylinder", "mesh"): 0.6, ("box", "mesh"): 0.99, ("ellipsoid", "box"): 0.9}
SLAB = "-.5 -.5 -.3 .5 -.5 -.3 .5 .5 -.3 -.5 .5 -.3 -.5 -.5 .3 .5 -.5 .3 .4 .5 .3 -.5 .5 .3"
TABLES = {"box": 'type="box" size=".4 .4 .3"', "mesh": 'type="mesh" mesh="slab"'}
SHAPES = {"capsule": 'type="capsule" size=".04 .07"', "cylinder": 'type="cylinder" size=".05 .06"'}
ROUGH = 'friction="1 .05 .005" condim="6"'


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_rows(pair: tuple[str, str]) -> None:
    assert shares(*pair, files=4, states=15)["equal"] > LEAST.get(pair, 0.7)


@pytest.mark.parametrize(("shape", "table"), [("capsule", "mesh"), ("cylinder", "box"), ("cylinder", "mesh")])
def test_rests_as_in_mujoco(shape: str, table: str) -> None:
    """Dropped lying, a little tilted: the same height and tilt, on forces that are its weight."""
    text = f"""<mujoco><option timestep=".002" cone="elliptic"/><asset><mesh name="slab" vertex="{SLAB}"/></asset>
    <worldbody><geom {TABLES[table]} pos="0 0 -.3" {ROUGH}/>
    <body><freejoint/><geom {SHAPES[shape]} mass="1" {ROUGH}/></body></worldbody></mujoco>"""
    file, draw, count, steps = mujoco.MjModel.from_xml_string(text), np.random.default_rng(0), 6, 700
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene, **mujocos(scene))
    start = np.zeros((count, 7))
    start[:, :3] = draw.uniform(-0.05, 0.05, (count, 3)) * [1, 1, 0] + [0, 0, 0.06]
    start[:, 3:] = [1, 1, 0, 0] + 0.02 * draw.normal(size=(count, 4))
    start[:, 3:] /= np.linalg.norm(start[:, 3:], axis=1, keepdims=True)
    q, v = start, np.zeros((count, 6))
    for _ in range(steps):
        step = model.predict(q, v, np.zeros((count, 0)), impulse=True)
        q, v = step.q_next, step.v_next
    assert step.impulse is not None
    np.testing.assert_allclose(step.impulse[..., 0].sum(axis=1) / 0.002, 9.81, rtol=1e-3)
    for k in range(count):
        data = mujoco.MjData(file)
        data.qpos[:] = start[k]
        for _ in range(steps):
            mujoco.mj_step(file, data)
        assert abs(q[k, 2] - data.qpos[2]) < 2e-6
        np.testing.assert_allclose(axis(q[k]), axis(data.qpos), atol=2e-4)


def axis(q: np.ndarray) -> float:
    """Vertical part of the shape's axis."""
    _, x, y, _ = q[3:]
    return float(1 - 2 * (x * x + y * y))
