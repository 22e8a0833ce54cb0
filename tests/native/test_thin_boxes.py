"""Boxes that are deeper in a plane than they are thick: MuJoCo's corners above the centre do not touch."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

IN_PLANE = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>'


def plate(joints: str = "<freejoint/>", floor: str = "0 0 1", thick: float = 0.001) -> mujoco.MjModel:
    option = '<option timestep=".002" tolerance="0" iterations="100"/>'
    body = f'<body pos="0 0 .05" zaxis="{floor}">{joints}<geom type="box" size=".2 .1 {thick / 2}" mass=".3"/></body>'
    plane = f'<geom type="plane" zaxis="{floor}" size="3 3 .1"/>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{plane}{body}</worldbody></mujoco>")


def thrown(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States in which the deepest corner is 1 to 10 mm in the floor, nearly flat or not."""
    rng = np.random.default_rng(0)
    turned = rng.normal(size=(count, scene.nv)) * np.geomspace(1e-3, 0.3, count)[:, None]
    q = scene.integrate(np.tile(scene.q0, (count, 1)), turned)
    for row in q:
        row[2 if scene.nv == 6 else 1] -= scene.gaps(row).min() + rng.uniform(1e-3, 1e-2)
    return q, 0.5 * rng.normal(size=(count, scene.nv)), np.zeros((count, 0))


@pytest.mark.parametrize("joints", ["<freejoint/>", IN_PLANE], ids=["free", "in a plane"])
@pytest.mark.parametrize("floor", ["0 0 1", ".3 0 1"])
def test_a_step_is_mujocos(joints: str, floor: str) -> None:
    theirs = plate(joints, floor)
    scene, data = Scene.from_mjcf(theirs), mujoco.MjData(theirs)
    q, v, u = thrown(scene, 60)
    under, found = 0, ComplementarityModel(scene, **mujocos(scene)).predict(q, v, u)
    for k in range(len(q)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_step(theirs, data)
        under += (scene.gaps(q[k]) < 0).sum() > (4 if scene.nv == 6 else 2)
        off = np.abs(found.v_next[k] - data.qvel).max() / np.abs(data.qvel - v[k]).max()
        assert off < 1e-4, (k, off)
    assert under > 10


def test_derivatives_are_those_of_the_step() -> None:
    scene = Scene.from_mjcf(plate())
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4), path_tolerance=1e-12, sliding="convex")
    row = compare(model, *thrown(scene, 8), 30)
    assert row["worst"] <= 1e-5, row


def test_rows_that_look_ahead_keep_all_corners() -> None:
    """There nothing sinks in so far by itself, and what starts there is pushed out by each."""
    scene = Scene.from_mjcf(plate(thick=0.02))
    q = scene.q0[None].copy()
    q[0, 2] = -0.02
    model = ComplementarityModel(scene)
    found = model.predict(q, np.zeros((1, 6)), np.zeros((1, 0)), impulse=True)
    assert found.impulse is not None
    assert (found.impulse[0, :, 0] > 0.0).sum() == 8
