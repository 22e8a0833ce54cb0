"""One step of robots of a few joints next to MuJoCo's, and its derivatives next to finite differences."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

INTEGRATORS = ("Euler", "implicitfast")
ARM = """<mujoco><option timestep=".01" integrator="{integrator}"/>
<default><geom contype="0" conaffinity="0"/></default>
<worldbody>{world}</worldbody>{rest}</mujoco>"""
TWO_LINKS = """<body {body}><joint name="shoulder" type="hinge" axis="0 1 0" damping=".3" {joint}/>
<geom type="capsule" size=".04" fromto="0 0 0 .4 0 0"/><body name="fore" pos=".4 0 0" {body}>
<joint name="elbow" type="hinge" axis="{axis}" armature=".02" {joint}/><geom type="capsule" size=".03"
fromto="0 0 0 .3 0 0"/><body pos=".3 0 0"><geom type="box" size=".05 .02 .03" pos=".02 .01 .05"/></body>
</body></body>"""
FLYING = """<body name="b">{root}<geom type="box" size=".1 .05 .03" pos=".02 .03 .01"/>
<site name="s" pos=".1 .2 .3" euler="20 40 60"/><body pos=".3 0 0"><joint name="ball" type="ball" pos=".05 0 0"/>
<geom size=".07" pos=".1 .1 0"/><body pos="0 .2 .1"><joint name="slide" type="slide" axis="1 1 0"/>
<joint name="hinge" axis="0 1 2" actuatorfrcrange="-.2 .3"/><geom type="capsule" size=".04 .1" pos=".1 0 0"/>
<body pos=".1 0 0" euler="10 20 30"><geom type="box" size=".1 .03 .06" pos="0 .1 .1"/><site name="t" pos="0 .1 0"/>
</body></body></body></body>"""
ROOTS = ['<joint name="root" type="free"/>', '<joint name="root" type="ball"/>', '<joint axis="0 1 1"/>']


def write(path: Path, integrator: str, world: str, rest: str = "") -> Path:
    file = path / "scene.xml"
    file.write_text(ARM.format(integrator=integrator, world=world, rest=rest), encoding="utf-8")
    return file


def states(scene: Scene, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), rng.normal(size=(count, scene.nv)))
    return q, rng.normal(size=(count, scene.nv)), rng.normal(size=(count, scene.nu))


def assert_like_mujoco(file: Path, count: int = 40, tolerance: float = 1e-9) -> mujoco.MjData:
    """v' of a step from random states, at once and in one batch; returns MuJoCo's data after the last."""
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    q, v, u = states(scene, count)
    r = ComplementarityModel(scene).predict(q, v, u)
    data = mujoco.MjData(model)
    for k in range(count):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k]
        mujoco.mj_step(model, data)
        size = max(1.0, float(np.abs(data.qvel).max()))
        np.testing.assert_allclose(r.v_next[k], data.qvel, rtol=0, atol=tolerance * size)
    return data


def assert_exact(file: Path, expected: set[str], count: int = 10, **settings: object) -> None:
    """The Jacobian against finite differences, and products with its transpose; ``expected`` groups are in it."""
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene, **settings)  # type: ignore[arg-type]
    q, v, u = states(scene, count, 1)
    row = compare(model, q, v, u, 60)
    assert expected <= set(row["kinds"])
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert row["across_kinks"] + row["vague"] <= 0.03 * row["columns"], row
    assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9
