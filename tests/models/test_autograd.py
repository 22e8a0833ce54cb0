"""Gradients through torch: one step by gradcheck, rollouts against the product of the native Jacobians."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import UserError
from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM

CUBE = Path(__file__).parents[2] / "tasks/cube_toss/scene.xml"
HOPPER = next(file for file in GYMNASIUM if file.stem == "hopper")
CALM = Ranges(gap=(0.0, 0.02), speed=0.5, at_limit=0.0)


def tensors(*arrays: np.ndarray) -> list[torch.Tensor]:
    return [torch.from_numpy(np.ascontiguousarray(x)).requires_grad_() for x in arrays]


@pytest.mark.parametrize("integrator", ["semi-implicit", "leapfrog", "midpoint"])
def test_gradcheck_of_one_step(integrator: str) -> None:
    scene = Scene.from_mjcf(HOPPER)
    smooth = Barrier(1e-2)
    model = ComplementarityModel(scene, 2, smoothing=smooth, integrator=integrator, path_tolerance=1e-12)
    q, v, u = tensors(*random_states(scene, 2, np.random.default_rng(0), CALM))
    losses = np.array([0.01 * p.high * (p.group == "frictionloss") for p in scene.parameters])  # off their kink at 0
    (theta,) = tensors(model.parameters * np.where(model.parameters > 0, 1.01, 1.0) + losses)
    assert torch.autograd.gradcheck(model.step, (q, v, u, theta), eps=1e-6, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize(
    ("file", "law", "integrator"),
    [
        (HOPPER, "mujoco", None),
        (CUBE, "mujoco", None),
        (CUBE, "rigid", None),
        (CUBE, "rigid", "midpoint"),
        (CUBE, "logistic", None),
    ],
)
def test_rollout_is_the_product_of_the_jacobians(file: Path, law: str, integrator: str | None) -> None:
    """32 steps of a batch: d loss / d (q, v, every u) backwards through torch and forwards by the chain rule."""
    scene, horizon, batch = Scene.from_mjcf(file, contact_law=law), 32, 5
    nv, nu = scene.nv, scene.nu
    model = ComplementarityModel(scene, smoothing=Barrier(1e-3), integrator=integrator)
    rng = np.random.default_rng(1)
    q0, v0, _ = random_states(scene, batch, rng, CALM)
    controls = rng.uniform(-1, 1, (batch, horizon, nu))
    weight = rng.normal(size=(2, batch, nv))
    q, v, u = tensors(q0, v0, controls)
    q_end, v_end = q, v
    for k in range(horizon):
        q_end, v_end = model.step(q_end, v_end, u[:, k])
    direction = model.stepper.tangent.to_configuration(q_end.detach().numpy(), weight[0])
    loss = (q_end * torch.from_numpy(direction)).sum() + (v_end * torch.from_numpy(weight[1])).sum()
    loss.backward()
    states, steps, qk, vk = [], [], q0, v0
    for k in range(horizon):
        r = model.predict(qk, vk, controls[:, k], jacobian=True)
        states.append((qk, vk))
        steps.append(r.jacobian)
        qk, vk = r.q_next, r.v_next
    np.testing.assert_array_equal(qk, q_end.detach().numpy())
    row = np.concatenate(weight, axis=1)[:, None]
    gu = np.zeros((batch, horizon, nu))
    for k in reversed(range(horizon)):
        row = row @ steps[k]
        gu[:, k], row = row[:, 0, 2 * nv :], row[:, :, : 2 * nv]
    size = np.abs(row).max()
    ours = model.stepper.tangent.to_tangent(q0, q.grad.numpy())
    np.testing.assert_allclose(ours, row[:, 0, :nv], rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(v.grad.numpy(), row[:, 0, nv:], rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(u.grad.numpy(), gu, rtol=0, atol=1e-9 * max(size, np.abs(gu).max(initial=0)))


def test_gradient_of_shared_parameters_is_the_sum() -> None:
    scene = Scene.from_mjcf(CUBE)
    model = ComplementarityModel(scene, smoothing=Barrier(1e-4))
    q, v, u = tensors(*random_states(scene, 6, np.random.default_rng(2), CALM))
    (shared,) = tensors(model.parameters)
    (each,) = tensors(np.tile(model.parameters, (6, 1)))
    for theta in (shared, each):
        _, v_next = model.step(q, v, u, theta)
        v_next.square().sum().backward()
    np.testing.assert_allclose(shared.grad.numpy(), each.grad.numpy().sum(0), rtol=1e-12)


def test_hard_forward_soft_backward() -> None:
    """The value is that of the hard step, the gradient that of the soft one at the same state."""
    scene = Scene.from_mjcf(CUBE)
    hard = ComplementarityModel(scene, smoothing=Barrier(1e-8), backward_smoothing=Barrier(1e-2))
    q, v, u = tensors(*random_states(scene, 4, np.random.default_rng(3), CALM))
    q_next, v_next = hard.step(q, v, u)
    exact = ComplementarityModel(scene, smoothing=Barrier(1e-8)).predict(*(x.detach().numpy() for x in (q, v, u)))
    np.testing.assert_allclose(v_next.detach().numpy(), exact.v_next, rtol=0, atol=1e-9)
    v_next.sum().backward()
    soft = ComplementarityModel(scene, smoothing=Barrier(1e-2)).predict(
        *(x.detach().numpy() for x in (q, v, u)), jacobian=True
    )
    nv = scene.nv
    np.testing.assert_allclose(v.grad.numpy(), soft.jacobian[:, nv:, nv : 2 * nv].sum(1), rtol=0, atol=1e-7)
    assert q_next.shape == q.shape


def test_failed_solves_warn() -> None:
    """A step that did not converge is counted and warned of, never passed on in silence."""
    scene = Scene.from_mjcf(CUBE)
    model = ComplementarityModel(scene)
    q, v, u = random_states(scene, 2, np.random.default_rng(4), CALM)
    v[0] = np.nan
    with pytest.warns(SolverWarning, match="1 of 2"):
        model.step(*(torch.from_numpy(x) for x in (q, v, u)))
    assert model.failures == 1


def hopper_step() -> tuple[ComplementarityModel, list[torch.Tensor]]:
    model = ComplementarityModel(Scene.from_mjcf(HOPPER), 2, smoothing=Barrier(1e-3))
    states = random_states(model.scene, 3, np.random.default_rng(0), CALM)
    return model, [*tensors(*states), *tensors(model.parameters)]


@pytest.mark.parametrize("which", range(4))
def test_a_second_derivative_is_refused(which: int) -> None:
    """A penalty on a gradient would otherwise lose its own gradient without a word."""
    model, inputs = hopper_step()
    q, v = model.step(*inputs)
    loss = q.sum() + (v * v).sum()
    (gradient,) = torch.autograd.grad(loss, inputs[which], create_graph=True)
    with pytest.raises(UserError, match="first derivatives only: leave out create_graph"):
        (loss + gradient.square().sum()).backward()


def test_create_graph_without_a_second_derivative() -> None:
    model, inputs = hopper_step()
    q, v = model.step(*inputs)
    plain = torch.autograd.grad(q.sum() + v.sum(), inputs, retain_graph=True)
    graph = torch.autograd.grad(q.sum() + v.sum(), inputs, create_graph=True)
    for ours, theirs in zip(graph, plain, strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize("which", range(4))
def test_an_input_changed_in_place_is_noticed(which: int) -> None:
    model, inputs = hopper_step()
    q, v = model.step(*inputs)
    with torch.no_grad():
        inputs[which] += 1e-3
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        (q.sum() + v.sum()).backward()


def test_a_next_state_changed_in_place() -> None:
    """Noticed where the gradient needs it (ball joints); right where it does not."""
    cube = ComplementarityModel(Scene.from_mjcf(CUBE), smoothing=Barrier(1e-3))
    q, v = cube.step(*tensors(*random_states(cube.scene, 3, np.random.default_rng(0), CALM)))
    with torch.no_grad():
        q += 1e-3
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        (q.sum() + v.sum()).backward()
    model, inputs = hopper_step()
    gradients = []
    for change in (0.0, 1.0):
        q, v = model.step(*inputs)
        with torch.no_grad():
            q += change
        gradients.append(torch.autograd.grad(q.sum() + v.sum(), inputs))
    for ours, theirs in zip(*gradients, strict=True):
        assert torch.equal(ours, theirs)
