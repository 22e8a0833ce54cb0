"""Random states of a robot that touches nothing, and its steps from there against MuJoCo's."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene


def states(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q (B, nq), v (B, nv), u (B, nu and activations)."""
    rng = np.random.default_rng(0)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), rng.normal(size=(count, scene.nv)))
    return q, rng.normal(size=(count, scene.nv)), 2 * rng.normal(size=(count, scene.core.nu))


def assert_steps_are_mujocos(model: ComplementarityModel, theirs: mujoco.MjModel, count: int) -> None:
    """v' to round-off, from ``count`` random states."""
    scene, data = model.scene, mujoco.MjData(theirs)
    q, v, u = states(scene, count)
    found = model.predict(q, v, u)
    for k in range(count):
        data.qpos[:], data.qvel[:], data.ctrl[:], data.act[:] = q[k], v[k], u[k, : scene.nu], u[k, scene.nu :]
        mujoco.mj_step(theirs, data)
        np.testing.assert_allclose(found.v_next[k], data.qvel, rtol=1e-9, atol=1e-11)
