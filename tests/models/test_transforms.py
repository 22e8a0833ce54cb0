"""Steps under torch.func: the same derivatives as backward passes one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch.autograd import forward_ad
from torch.func import grad, hessian, jacfwd, jacrev, jvp, vmap

from cmbrl.contact import Barrier, Relaxed
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

# A ball joint (quaternions), a hinge with a motor, and a floor to touch.
MJCF = """<mujoco><option timestep=".005"/><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .32">
<joint type="ball"/><geom type="capsule" size=".03" fromto="0 0 0 .2 0 -.1"/><body pos=".2 0 -.1">
<joint name="b" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .1 0 -.2"/></body></body></worldbody>
<actuator><motor joint="b" gear="3"/></actuator></mujoco>"""
MANY = 3


@pytest.fixture(scope="module")
def model() -> ComplementarityModel:
    return ComplementarityModel(Scene.from_mjcf(MJCF), smoothing=Barrier(1e-3))


@pytest.fixture
def states(model: ComplementarityModel) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """MANY batches of two rows."""
    torch.manual_seed(0)
    scene = model.scene
    q = torch.tensor(scene.q0).expand(MANY, 2, -1) + 0.1 * torch.randn(MANY, 2, scene.nq, dtype=torch.float64)
    q[..., :4] /= q[..., :4].norm(dim=-1, keepdim=True)
    v, u = (torch.randn(MANY, 2, n, dtype=torch.float64) for n in (scene.nv, scene.nu))
    return q, v, u


def one_by_one(model: ComplementarityModel, outcome: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """The Jacobian of ``outcome`` (n,) by x, by backward passes."""
    return torch.stack([torch.autograd.grad(y, x, retain_graph=True)[0] for y in outcome])


def test_a_jacobian_by_reverse_mode(model: ComplementarityModel, states: tuple[torch.Tensor, ...]) -> None:
    q, v, u = (x[0] for x in states)
    for k, given in enumerate((q, v, u, torch.tensor(model.parameters))):

        def outcome(x: torch.Tensor, k: int = k) -> torch.Tensor:
            arguments = [q, v, u, torch.tensor(model.parameters)]
            arguments[k] = x
            return torch.cat(model.step(*arguments), dim=1).ravel()

        x = given.clone().requires_grad_()
        expected = one_by_one(model, outcome(x), x)
        assert expected.abs().max() > 1e-6
        assert torch.equal(jacrev(outcome)(given), expected)


def test_many_batches_at_once(model: ComplementarityModel, states: tuple[torch.Tensor, ...]) -> None:
    q, v, u = states
    q_next, v_next = vmap(model.step)(q, v, u)
    for k in range(MANY):
        alone = model.step(q[k], v[k], u[k])
        assert torch.equal(q_next[k], alone[0])
        assert torch.equal(v_next[k], alone[1])
    same_q = vmap(lambda v: model.step(q[0], v, u[0])[1])(v)  # what is not mapped is the same for all
    assert torch.equal(same_q[2], model.step(q[0], v[2], u[0])[1])


def test_gradients_of_many_batches(model: ComplementarityModel, states: tuple[torch.Tensor, ...]) -> None:
    """Each with its own, by the state and by parameters that are the same for all."""
    q, v, u = states
    theta = torch.tensor(model.parameters)

    def cost(v: torch.Tensor, theta: torch.Tensor, q: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return torch.cat(model.step(q, v, u, theta), dim=1).square().sum()

    by_v, by_theta = vmap(grad(cost, argnums=(0, 1)), in_dims=(0, None, 0, 0))(v, theta, q, u)
    jacobians = vmap(jacrev(lambda v, q, u: model.step(q, v, u)[1]))(v, q, u)
    for k in range(MANY):
        x, p = v[k].clone().requires_grad_(), theta.clone().requires_grad_()
        expected = torch.autograd.grad(cost(x, p, q[k], u[k]), (x, p))
        torch.testing.assert_close(by_v[k], expected[0], rtol=1e-12, atol=1e-12)
        torch.testing.assert_close(by_theta[k], expected[1], rtol=1e-12, atol=1e-12)
        alone = one_by_one(model, model.step(q[k], x, u[k])[1].ravel(), x)
        torch.testing.assert_close(jacobians[k].reshape(alone.shape), alone, rtol=1e-12, atol=1e-12)


def both_ways(model: ComplementarityModel, given: tuple[torch.Tensor, ...], k: int) -> tuple[torch.Tensor, ...]:
    """The Jacobian by argument k, forwards and backwards."""

    def outcome(*arguments: torch.Tensor) -> torch.Tensor:
        return torch.cat(model.step(*arguments), dim=1)

    return jacfwd(outcome, argnums=k)(*given), jacrev(outcome, argnums=k)(*given)


@pytest.mark.parametrize("k", range(4))
def test_a_jacobian_by_forward_mode(model: ComplementarityModel, states: tuple[torch.Tensor, ...], k: int) -> None:
    """Also where the derivative is softer than the step, over several physics steps."""
    soft = model.with_settings(substeps=3, smoothing=Relaxed(1e-3), backward_smoothing=Relaxed(1e-2))
    given = (*(x[0] for x in states), torch.tensor(model.parameters))
    for one in (model, soft):
        forwards, backwards = both_ways(one, given, k)
        assert backwards.abs().max() > 1e-6
        torch.testing.assert_close(forwards, backwards, rtol=1e-9, atol=1e-9)


def test_parameters_of_their_own_by_forward_mode(model: ComplementarityModel, states: tuple[torch.Tensor, ...]) -> None:
    theta = torch.tensor(model.parameters).repeat(2, 1)
    forwards, backwards = both_ways(model, (*(x[0] for x in states), theta), 3)
    torch.testing.assert_close(forwards, backwards, rtol=1e-9, atol=1e-9)


def test_a_tangent_goes_through_a_rollout(model: ComplementarityModel, states: tuple[torch.Tensor, ...]) -> None:
    """Three steps: the directional derivative, by torch.func and by dual numbers, with and without gradients."""
    q, v, u = (x[0] for x in states)
    direction = torch.randn_like(v)

    def end(v: torch.Tensor) -> torch.Tensor:
        at, speed = q, v
        for _ in range(3):
            at, speed = model.step(at, speed, u)
        return torch.cat([at, speed], dim=1)

    x = v.clone().requires_grad_()
    weight = torch.randn_like(end(v))
    (cotangent,) = torch.autograd.grad((weight * end(x)).sum(), x)
    expected = (cotangent * direction).sum()
    found = [(weight * jvp(end, (v,), (direction,))[1]).sum()]
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(v, direction)
        for mode in (torch.enable_grad, torch.no_grad):
            with mode():
                found.append((weight * forward_ad.unpack_dual(end(dual)).tangent).sum())
        assert forward_ad.unpack_dual(end(v)).tangent is None
    for one in found:
        torch.testing.assert_close(one, expected, rtol=1e-9, atol=1e-9)


def test_forward_mode_of_many_batches(model: ComplementarityModel, states: tuple[torch.Tensor, ...]) -> None:
    found = vmap(lambda q, v, u: jacfwd(lambda v: model.step(q, v, u)[1])(v))(*states)
    for k in range(MANY):
        q, v, u = (x[k] for x in states)
        alone = jacrev(lambda v, q=q, u=u: model.step(q, v, u)[1])(v)
        torch.testing.assert_close(found[k], alone, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("strategy", ["reverse-mode", "forward-mode"])
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_vectorised_jacobians_of_torch_autograd(
    model: ComplementarityModel, states: tuple[torch.Tensor, ...], strategy: str
) -> None:
    given = (*(x[0] for x in states), torch.tensor(model.parameters))
    jacobian = torch.autograd.functional.jacobian
    found = jacobian(model.step, given, vectorize=True, strategy=strategy)
    expected = jacobian(model.step, given)
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("second", [hessian, lambda f: jacrev(jacfwd(f)), lambda f: jacfwd(jacfwd(f))])
def test_a_second_derivative_by_forward_mode_is_refused(
    model: ComplementarityModel, states: tuple[torch.Tensor, ...], second: Callable[..., Any]
) -> None:
    q, v, u = (x[0] for x in states)
    with pytest.raises(UserError, match="first derivatives only"):
        second(lambda v: model.step(q, v, u)[1].sum())(v)


def test_a_second_derivative_is_refused(model: ComplementarityModel, states: tuple[torch.Tensor, ...]) -> None:
    q, v, u = (x[0] for x in states)
    with pytest.raises(UserError, match="first derivatives only"):
        grad(lambda v: grad(lambda v: model.step(q, v, u)[1].sum())(v).sum())(v)


def test_torch_compile_is_told_what_to_do(
    model: ComplementarityModel, states: tuple[torch.Tensor, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
    with pytest.raises(UserError, match=r"torch\.compiler\.disable"):
        model.step(*(x[0] for x in states))
