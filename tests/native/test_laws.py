"""The softness of contacts and limits is MuJoCo's, read from its own constraint rows."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

SPHERE = """<mujoco><option cone="{cone}" impratio="{impratio}"/><worldbody>
<geom type="plane" size="1 1 1" friction=".01"/>
<body pos="0 0 {height}"><freejoint/><geom size=".1" mass="2" condim="3" friction="{mu}" priority="1"/></body>
</worldbody></mujoco>"""
HEIGHT = 0.0995


def both(text: str, folder: Path) -> tuple[ComplementarityModel, mujoco.MjModel, mujoco.MjData]:
    file = folder / "scene.xml"
    file.write_text(text, encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.tolerance, model.opt.iterations = 0.0, 200
    return ComplementarityModel(Scene.from_mjcf(file)), model, mujoco.MjData(model)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("mu", [0.1, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("impratio", [0.3, 1.0, 10.0])
def test_friction_is_as_soft_as_in_mujoco(cone: str, mu: float, impratio: float, tmp_path: Path) -> None:
    """A pyramid's edges f cost R f^2/2: as one normal row and two tangents R/4 and R/(2 mu^2) while all edges press."""
    ours, model, data = both(SPHERE.format(cone=cone, impratio=impratio, mu=mu, height=HEIGHT), tmp_path)
    mujoco.mj_forward(model, data)
    edge = data.efc_R[0]
    expected = [edge / 4, edge / (2 * mu**2)] if cone == "pyramidal" else data.efc_R[:2]
    problem = ours.contact_problems(data.qpos[None], data.qvel[None], np.zeros((1, 0)))[0]
    np.testing.assert_allclose(problem.R[0], [expected[0], expected[1], expected[1]], rtol=1e-12)
    # A sphere that sticks, pushed down and along one of MuJoCo's tangents: the same step.
    data.qvel[:] = [1e-4, 0.0, -0.02, 0.0, 1e-3, 0.0]
    r = ours.predict(data.qpos[None], data.qvel[None], np.zeros((1, 0)))
    mujoco.mj_step(model, data)
    forces = data.efc_force
    assert (forces > 0).all() if cone == "pyramidal" else np.linalg.norm(forces[1:]) < 0.99 * mu * forces[0]
    np.testing.assert_allclose(r.v_next[0], data.qvel, rtol=0, atol=1e-7)


def test_a_sliding_sphere_is_braked_by_the_full_friction(tmp_path: Path) -> None:
    """By mu times the impulse that its normal row alone asks for, under either cone."""
    for cone in ("pyramidal", "elliptic"):
        ours, _, data = both(SPHERE.format(cone=cone, impratio=10, mu=0.5, height=HEIGHT), tmp_path)
        state = data.qpos[None], np.array([[3.0, 0.0, -0.02, 0.0, 0.0, 0.0]]), np.zeros((1, 0))
        problem = ours.contact_problems(*state)[0]
        normal = -problem.free_contact_velocity()[0, 0] / (problem.delassus()[0, 0] + problem.R[0, 0])
        impulse = problem.M[:3, :3] @ (ours.predict(*state).v_next - problem.v_free)[0, :3]
        np.testing.assert_allclose(impulse, [-0.5 * normal, 0.0, normal], rtol=1e-6, atol=1e-9)


POWERS = (1, 2, 3)
MIDPOINTS = (0.0, 1e-3, 0.5, 1.0)
ENDS = ((0.9, 0.95), (0.0, 1.0), (0.6, 0.6), (0.95, 0.2))


@pytest.mark.parametrize("width", [0.0, 1e-16, 1e-3])
def test_impedance_is_that_of_mujoco(width: float, tmp_path: Path) -> None:
    """Over ends, midpoints and powers of the sigmoid, extremes included, at depths from first touch to saturation."""
    grid = list(product(ENDS, MIDPOINTS, POWERS))
    balls = "".join(
        f'<body pos="{k} 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1" condim="1" priority="1" '
        f'contype="2" conaffinity="0" solimp="{low} {high} {width} {mid} {power}"/></body>'
        for k, ((low, high), mid, power) in enumerate(grid)
    )
    text = (
        '<mujoco><option cone="elliptic"/><worldbody>'
        f'<geom type="plane" size="1 1 1" conaffinity="2" contype="0"/>{balls}</worldbody></mujoco>'
    )
    ours, model, data = both(text, tmp_path)
    for depth in (1e-9, 3e-7, 2e-4, 5e-4, 9e-4, 2e-3):
        data.qpos[:] = -depth
        mujoco.mj_forward(model, data)
        KBIP, order = np.asarray(data.efc_KBIP).reshape(-1, 4), data.contact.geom[:, 1] - 1
        assert sorted(order) == list(range(len(grid)))
        q = data.qpos[None]
        problem = ours.contact_problems(q, np.zeros_like(q), np.zeros((1, 0)))[0]
        np.testing.assert_allclose(1 / (1 + problem.R[order, 0]), KBIP[:, 2], rtol=1e-9)
        np.testing.assert_allclose(
            problem.b[order, 0], -model.opt.timestep * depth * KBIP[:, 0] * KBIP[:, 2], rtol=1e-6, atol=1e-15
        )
        r = ours.predict(q, np.zeros_like(q), np.zeros((1, 0)), jacobian=True)
        assert r.status[0] == 0
        assert r.jacobian is not None
        assert np.isfinite(r.jacobian).all()
