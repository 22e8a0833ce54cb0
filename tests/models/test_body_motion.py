"""Motions of bodies against MuJoCo, and their products with cotangents against finite differences."""

from __future__ import annotations

import pickle

import mujoco
import numpy as np
import pytest
import torch
from torch.autograd import forward_ad
from torch.func import jacrev, jvp, vmap

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


TOOL = """
<mujoco model="arm"><worldbody><body name="stand" pos="0 0 0.5"><geom size="0.1"/>
<body name="upper"><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<body name="lower" pos="0.3 0 0"><joint name="b" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/>
<body name="wrist" pos="0.2 0 0.01" euler="0 20 0"><body name="hand" pos="0.05 0.02 0" euler="30 0 40">
<geom size="0.02"/><site name="tip" pos="0.04 0 0.03" euler="0 0 15"/><site name="upper" pos="1 0 0"/>
</body></body></body></body></body></worldbody></mujoco>"""


def test_what_is_fixed_to_a_body_moves_with_it() -> None:
    scene, names = Scene.from_mjcf(TOOL), ("hand", "tip", "upper", "wrist")
    q, v = states(scene, 4)
    found = BodyMotions(scene, names)(q, v)
    model = mujoco.MjModel.from_xml_string(TOOL)
    data = mujoco.MjData(model)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_forward(model, data)
        for i, name in enumerate(names):
            site = name == "tip"
            kind = mujoco.mjtObj.mjOBJ_SITE if site else mujoco.mjtObj.mjOBJ_XBODY
            one, twist = (data.site(name) if site else data.body(name)), np.zeros(6)
            mujoco.mj_objectVelocity(model, data, kind, one.id, twist, 0)
            np.testing.assert_allclose(found.position[k, i], one.xpos, atol=1e-12)
            np.testing.assert_allclose(found.rotation[k, i], one.xmat.reshape(3, 3), atol=1e-12)
            np.testing.assert_allclose(found.angular[k, i], twist[:3], atol=1e-11)
            np.testing.assert_allclose(found.linear[k, i], twist[3:], atol=1e-11)
    with pytest.raises(UserError, match="no body or site 'stand' that moves"):
        BodyMotions(scene, ["stand"])


@pytest.mark.parametrize("carried", [False, True])
def test_products_agree_with_finite_differences(scene: Scene, carried: bool) -> None:
    names = ("hand", "tip") if carried else BODIES
    scene = Scene.from_mjcf(TOOL) if carried else scene
    motions = BodyMotions(scene, names)
    q, v = states(scene, 3, seed=1)
    q.requires_grad_(), v.requires_grad_()
    rng = np.random.default_rng(2)
    weights = torch.from_numpy(rng.normal(size=(3, len(names), 18)))

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


def test_torch_func_goes_backwards_through_motions() -> None:
    """jacrev and vmap as backward passes one by one; what goes forwards is refused, never zero."""
    scene = Scene.from_mjcf(TOOL)
    motions = BodyMotions(scene, ["tip"])
    q, v = states(scene, 3)

    def tip(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        motion = motions(q, v)
        return torch.cat([motion.position, motion.linear], dim=-1)[:, 0]

    x = q.clone().requires_grad_()
    expected = torch.stack([torch.autograd.grad(y, x, retain_graph=True)[0] for y in tip(x, v).ravel()])
    assert expected.abs().max() > 0.1
    torch.testing.assert_close(jacrev(tip)(q, v).reshape(expected.shape), expected)
    alone = vmap(jacrev(lambda q, v: tip(q[None], v[None])[0]))(q, v)
    for k in range(3):
        torch.testing.assert_close(alone[k], jacrev(tip)(q, v)[k, :, k])
    with pytest.raises(UserError, match="go backwards only: use jacrev"):
        jvp(lambda q: tip(q, v), (q,), (v,))
    with forward_ad.dual_level(), torch.no_grad(), pytest.raises(UserError, match="go backwards only"):
        tip(forward_ad.make_dual(q, v), v)
    with pytest.raises(UserError, match="first derivatives only"):
        jacrev(jacrev(lambda q: tip(q, v)))(q)


def test_rows_that_are_not_finite_and_copies(scene: Scene) -> None:
    motions = BodyMotions(scene, BODIES)
    q, v = states(scene, 3)
    q[1, 0] = np.nan
    found, again = motions(q, v).position, pickle.loads(pickle.dumps(motions))(q, v).position
    assert torch.isnan(found[1]).all()
    assert torch.isfinite(found[[0, 2]]).all()
    np.testing.assert_array_equal(found, again)


def test_what_has_no_motion_is_refused(scene: Scene) -> None:
    with pytest.raises(UserError, match=r"no body or site 'pelvs' that moves: did you mean 'pelvis'"):
        BodyMotions(scene, ["pelvs"])
    with pytest.raises(UserError, match="reduce=False"):
        BodyMotions(load_task("hopper").load_scene(), ["torso"])
