"""Estimators with noise on the controls against the gradient of a linear-Gaussian chain, known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.gradients import Estimate, Rollout, pathwise, score_function, total_propagation
from cmbrl.gradients.pipps import Future, NoisyNode, combine, path_weight, returns_to_go
from cmbrl.gradients.score import leave_one_out

A, B, COST, STD, STATE_STD, START = 1.1, 0.5, 0.1, 0.3, 0.2, 0.8


@dataclass(frozen=True)
class Chain:
    """v' = a v + b u; q counts nothing."""

    a: float = A
    name: str = "chain"
    dt: float = 1.0

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        return q, self.a * v + B * u


def chain(samples: int, horizon: int = 6, a: float = A) -> Rollout:
    q = torch.zeros(samples, 1, dtype=torch.float64)
    return Rollout(
        Chain(a), lambda x, q, v: x[:, :1] * v + x[:, 1:], lambda u, q, v: -(v[:, 0] ** 2) - COST * u[:, 0] ** 2,
        horizon, q, torch.full_like(q, START),
    )  # fmt: skip


def truth(x: np.ndarray, horizon: int = 6, a: float = A, state_std: float = 0.0) -> np.ndarray:
    """Derivative of the expected return by the moments of the state: E v and E v^2 close among themselves."""
    k, c = theta = torch.tensor(x, requires_grad=True)
    mean, square, total = torch.tensor(START), torch.tensor(START**2), torch.tensor(0.0, dtype=torch.float64)
    for _ in range(horizon):
        u_square = k**2 * square + 2 * k * c * mean + c**2 + STD**2
        cross = k * square + c * mean  # E u v
        square = a**2 * square + 2 * a * B * cross + B**2 * u_square + state_std**2
        mean = a * mean + B * (k * mean + c)
        total = total - square - COST * u_square
    return np.asarray(torch.autograd.grad(total, theta)[0].numpy())


AT = np.array([-0.7, 0.2])
Estimator = Callable[[Rollout, np.random.Generator], Estimate]
ESTIMATORS: dict[str, Estimator] = {
    "score, nominal": lambda r, g: score_function(r, AT, STD, g, "nominal"),
    "score, others": lambda r, g: score_function(r, AT, STD, g, "others"),
    "score, none": lambda r, g: score_function(r, AT, STD, g, "none"),
    "total propagation": lambda r, g: total_propagation(r, AT, STD, g),
}


@pytest.mark.parametrize("name", ESTIMATORS)
def test_unbiased(name: str) -> None:
    estimate = ESTIMATORS[name](chain(40000), np.random.default_rng(0))
    assert np.all(np.abs(estimate.mean - truth(AT)) < 4 * np.sqrt(estimate.variance / estimate.samples))
    assert estimate.standard_error < 0.2 * np.linalg.norm(truth(AT))


def test_total_propagation_with_noise_on_states() -> None:
    estimate = total_propagation(chain(40000), AT, STD, np.random.default_rng(1), (0.0, STATE_STD))
    expected = truth(AT, state_std=STATE_STD)
    assert np.all(np.abs(estimate.mean - expected) < 4 * np.sqrt(estimate.variance / estimate.samples))
    assert estimate.standard_error < 0.05 * np.linalg.norm(expected)


def test_costs() -> None:
    """One rollout of six steps a sample, two with the nominal baseline; only total propagation differentiates."""
    costs = {
        n: (e := f(chain(10), np.random.default_rng(0)), e.steps, e.derivative_steps) for n, f in ESTIMATORS.items()
    }
    assert {n: c[1:] for n, c in costs.items()} == {
        "score, nominal": (120, 0), "score, others": (60, 0), "score, none": (60, 0), "total propagation": (60, 60),
    }  # fmt: skip


def test_baselines_lower_the_variance() -> None:
    plain, others = (
        score_function(chain(4000), AT, STD, np.random.default_rng(0), baseline=b) for b in ("none", "others")
    )
    assert others.total_variance < 0.8 * plain.total_variance


@dataclass
class Chaos:
    """v' = 3 sin(3 v) + u + noise: bounded, with slopes up to 9; nearby states part within a few steps."""

    rng: np.random.Generator
    std: float
    name: str = "chaos"
    dt: float = 1.0

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        return q, 3 * torch.sin(3 * v) + u + torch.from_numpy(self.std * self.rng.normal(size=v.shape))


def test_chaos() -> None:
    """Path gradients explode, total propagation keeps to the score function; noise on states lowers its variance."""
    x, samples, rng = np.array([0.3, 0.1]), 20000, np.random.default_rng(0)
    start = torch.full((samples, 1), START, dtype=torch.float64)

    def rollout(noise: float) -> Rollout:
        return Rollout(
            Chaos(rng, noise), lambda x, q, v: x[:, :1] * torch.cos(v) + x[:, 1:], lambda u, q, v: torch.cos(v[:, 0]),
            12, torch.zeros_like(start), start,
        )  # fmt: skip

    parameters = torch.tensor(np.tile(x, (samples, 1)), requires_grad=True)
    rewards = rollout(STATE_STD).rewards(parameters, lambda u: u + torch.from_numpy(STD * rng.normal(size=u.shape)))
    path = Estimate(torch.autograd.grad(torch.stack(rewards).sum(), parameters)[0].numpy(), 0)
    score = score_function(rollout(STATE_STD), x, STD, rng, "others")
    actions = total_propagation(rollout(STATE_STD), x, STD, rng)
    states = total_propagation(rollout(0.0), x, STD, rng, (0.0, STATE_STD))
    for mixed in (actions, states):
        error = np.hypot(np.sqrt(score.variance / samples), np.sqrt(mixed.variance / samples))
        assert np.all(np.abs(mixed.mean - score.mean) < 4 * error)
        assert path.total_variance > 1e6 * mixed.total_variance
    assert states.total_variance < actions.total_variance < score.total_variance


def test_node_mixes_by_inverse_variance() -> None:
    """Message of one node by hand: G = u^2 of four particles, path 2 u, score (G - mean of others) noise / std."""
    noise = torch.tensor([[0.5], [-1.0], [2.0], [0.1]], dtype=torch.float64)
    mean = torch.full((4, 1), 0.3, dtype=torch.float64, requires_grad=True)
    future = Future()
    u = NoisyNode.apply(mean, noise, 0.7, future)
    value = u[:, 0] ** 2
    future.value = value.detach()
    (message,) = torch.autograd.grad(value.sum(), mean)
    path = 2 * u.detach()
    others = (future.value.sum() - future.value) / 3
    score = ((future.value - others)[:, None] * noise) / 0.7
    v_path, v_score = (float(((m - m.mean()) ** 2).sum()) for m in (path, score))
    expected = (v_score * path + v_path * score) / (v_path + v_score)
    torch.testing.assert_close(message, expected, rtol=1e-12, atol=1e-12)


def test_weights() -> None:
    assert path_weight(1.0, 3.0) == 0.75
    assert path_weight(0.0, 3.0) == 1.0
    assert path_weight(2.0, 0.0) == 0.0
    assert path_weight(0.0, 0.0) == 0.5
    assert path_weight(float("inf"), 1.0) == 0.0
    constant = torch.ones(5, 2, dtype=torch.float64)
    torch.testing.assert_close(combine(constant, 3 * constant), 2 * constant)
    broken = torch.full((5, 2), float("nan"), dtype=torch.float64)
    torch.testing.assert_close(combine(broken, constant), constant)  # never NaN while the score function has a number


def test_without_noise_in_the_return_it_is_the_path_gradient() -> None:
    """A linear return: the path message does not vary, so it alone counts."""
    start = torch.ones(8, 1, dtype=torch.float64)
    objective = Rollout(Chain(), lambda x, q, v: x[:, :1], lambda u, q, v: v[:, 0], 4, torch.zeros_like(start), start)
    x = np.array([0.3])
    exact = pathwise(objective, x, 8)
    mixed = total_propagation(objective, x, STD, np.random.default_rng(0))
    np.testing.assert_allclose(mixed.gradients, exact.gradients, rtol=1e-12)


def test_helpers() -> None:
    values = torch.tensor([1.0, 2.0, 6.0], dtype=torch.float64)
    assert leave_one_out(values).tolist() == [4.0, 3.5, 1.5]
    assert [r.tolist() for r in returns_to_go([values, values])] == [[2.0, 4.0, 12.0], [1.0, 2.0, 6.0]]


def test_refusals() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(UserError, match="one of nominal, others, none"):
        score_function(chain(3), AT, STD, rng, "mean")
    with pytest.raises(UserError, match="give a positive std"):
        total_propagation(chain(3), AT, 0.0, rng)
