"""Motions of bodies against MuJoCo, and their products with cotangents against finite differences."""

from __future__ import annotations

import pickle

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.errors import UserError
from cmbrl.models.body_motion import BodyMotions
from cmbrl.registry import load_task
from cmbrl.scene import Scene

BODIES = ("pelvis", "torso_link", "left_ankle_roll_link", "right_wrist_yaw_link", "left_elbow_link")


def states(scene: Scene, count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), rng.normal(size=(count, scene.nv)))
    return torch.from_numpy(q), torch.from_numpy(rng.normal(size=(count, scene.nv)))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_task("g1").load_scene()


def test_motions_are_mujocos(scene: Scene) -> None:
    q, v = states(scene, 9)
    found = BodyMotions(scene, BODIES)(q, v)
    model = mujoco.MjModel.from_xml_path(scene.path)
    data = mujoco.MjData(model)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_forward(model, data)
        for i, name in enumerate(BODIES):
            body = model.body(name).id
            twist = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
            np.testing.assert_allclose(found.position[k, i], data.xpos[body], atol=1e-12)
            np.testing.assert_allclose(found.rotation[k, i], data.xmat[body].reshape(3, 3), atol=1e-12)
            np.testing.assert_allclose(found.angular[k, i], twist[:3], atol=1e-11)
            np.testing.assert_allclose(found.linear[k, i], twist[3:], atol=1e-11)


def test_products_agree_with_finite_differences(scene: Scene) -> None:
    motions = BodyMotions(scene, BODIES)
    q, v = states(scene, 3, seed=1)
    q.requires_grad_(), v.requires_grad_()
    rng = np.random.default_rng(2)
    weights = torch.from_numpy(rng.normal(size=(3, len(BODIES), 18)))

    def value(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        m = motions(q, v)
        rows = torch.cat([m.position, m.rotation.flatten(2), m.linear, m.angular], dim=-1)
        return (weights * rows).sum((1, 2))

    gq, gv = torch.autograd.grad(value(q, v).sum(), (q, v))
    at, speed = q.detach().numpy(), v.detach().numpy()
    for _ in range(20):
        dq, dv = rng.normal(size=(2, 3, scene.nv))
        ends = [
            value(torch.from_numpy(scene.integrate(at, s * dq)), torch.from_numpy(speed + s * dv))
            for s in (1e-6, -1e-6)
        ]
        slope = (ends[0] - ends[1]).numpy() / 2e-6
        moved = (scene.integrate(at, 1e-6 * dq) - scene.integrate(at, -1e-6 * dq)) / 2e-6
        np.testing.assert_allclose((gq.numpy() * moved).sum(1) + (gv.numpy() * dv).sum(1), slope, rtol=1e-6, atol=1e-6)


def test_rows_that_are_not_finite_and_copies(scene: Scene) -> None:
    motions = BodyMotions(scene, BODIES)
    q, v = states(scene, 3)
    q[1, 0] = np.nan
    found, again = motions(q, v).position, pickle.loads(pickle.dumps(motions))(q, v).position
    assert torch.isnan(found[1]).all()
    assert torch.isfinite(found[[0, 2]]).all()
    np.testing.assert_array_equal(found, again)


def test_what_has_no_motion_is_refused(scene: Scene) -> None:
    with pytest.raises(UserError, match=r"no body 'pelvs': did you mean 'pelvis'"):
        BodyMotions(scene, ["pelvs"])
    with pytest.raises(UserError, match="reduce=False"):
        BodyMotions(load_task("hopper").load_scene(), ["torso"])
