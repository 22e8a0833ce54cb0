"""The reduced tree has MuJoCo's mass matrix, in the plane and in space: fused bodies, several joints, several trees."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.scene import Scene

from .conftest import Load, random_tree

STEP = 1e-5


def mass_matrix(scene: Scene, q: np.ndarray) -> np.ndarray:
    """M (nv, nv) from kinetic energy: sum of m Jv'Jv + Jw'I Jw, Jacobians by central differences of ``body_poses``."""
    core, nv = scene.core, scene.nv
    D = 2 if scene.planar else 3
    layout = scene.layout
    steps = STEP * np.vstack([np.eye(nv), -np.eye(nv)])
    pos, rot = scene.body_poses(scene.integrate(q, steps))
    _, here = scene.body_poses(q)
    M = np.diag([core.P[layout.dof(k)] for k in range(nv)])
    for b in range(core.nbody):
        com = core.P[layout.com(b) : layout.inertia(b)]
        centre = pos[:, b] + rot[:, b] @ com
        Jv = (centre[:nv] - centre[nv:]) / (2 * STEP)
        turn = here[b].T @ (rot[:nv, b] - rot[nv:, b]) / (2 * STEP)
        I = core.P[layout.inertia(b) : layout.mass(b + 1)]  # noqa: E741
        if D == 2:
            Jw, I = turn[:, 1:, 0], I.reshape(1, 1)  # noqa: E741
        else:
            Jw = np.column_stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]])
            I = np.array([[I[0], I[3], I[4]], [I[3], I[1], I[5]], [I[4], I[5], I[2]]])  # noqa: E741
        M += core.P[layout.mass(b)] * Jv @ Jv.T + Jw @ I @ Jw.T
    return M


def assert_same_mass_matrix(scene: Scene, model: mujoco.MjModel, seed: int = 0) -> None:
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    for _ in range(3):
        q = scene.integrate(scene.q0, rng.normal(size=scene.nv))
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        dense = np.zeros((model.nv, model.nv))
        for k, unit in enumerate(np.eye(model.nv)):
            mujoco.mj_mulM(model, data, dense[k], unit)
        assert np.abs(mass_matrix(scene, q) - dense).max() < 1e-8 * np.abs(dense).max()


def test_robots(robot: tuple[Scene, mujoco.MjModel]) -> None:
    scene, model = robot
    assert scene.planar == (scene.name != "humanoid")
    assert_same_mass_matrix(scene, model)
    assert scene.total_mass == pytest.approx(model.body_mass.sum())


@pytest.mark.parametrize("seed", range(6))
def test_random_trees(seed: int, load: Load) -> None:
    scene, model = load(random_tree(seed))
    assert scene.core.nbody < model.nbody
    assert_same_mass_matrix(scene, model, seed)


@pytest.mark.parametrize("turn", ["1 0 0 0", "1 1 0 0", "0 1 1 0", ".3 -.2 .9 .1"])
def test_random_planar_trees(turn: str, load: Load) -> None:
    """In x-y, x-z, y-z and a plane in no direction in particular."""
    for seed in range(3):
        scene, model = load(random_tree(seed, turn=turn, planar=True))
        assert scene.planar, scene.planar_why
        assert_same_mass_matrix(scene, model, seed)


def test_gravity_lies_in_the_plane(load: Load) -> None:
    """The potential's slope along each coordinate is MuJoCo's bias force at rest."""
    scene, model = load(random_tree(3, turn=".3 -.2 .9 .1", planar=True))
    assert scene.planar
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    core = scene.core
    layout = scene.layout
    pos, rot = scene.body_poses(scene.integrate(scene.q0, STEP * np.vstack([np.eye(scene.nv), -np.eye(scene.nv)])))
    energy = np.zeros(2 * scene.nv)
    for b in range(core.nbody):
        centre = pos[:, b] + rot[:, b] @ core.P[layout.com(b) : layout.com(b) + 2]
        energy -= core.P[layout.mass(b)] * centre @ scene.gravity
    slope = (energy[: scene.nv] - energy[scene.nv :]) / (2 * STEP)
    assert slope == pytest.approx(data.qfrc_bias, abs=1e-8)
