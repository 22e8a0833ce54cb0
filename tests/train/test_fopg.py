"""FOPG's four estimators on a linear-quadratic process with a known gradient; learning; going on bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from cmbrl.contact import Gaussian
from cmbrl.errors import UserError
from cmbrl.gradients import derivative_model
from cmbrl.gradients.per_sample import per_sample_gradients
from cmbrl.mdp import MDP, never, uniform
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.train.fopg import ESTIMATORS, FOPG, FOPGConfig
from cmbrl.train.models import with_derivative
from cmbrl.train.policies.policy import network
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.trainer import Diverged, Trainer

A, B, COST, START, STD, DISCOUNT, HORIZON = 0.9, 0.4, 0.2, 0.3, 0.1, 0.95, 5


@dataclass
class Linear:
    """v' = a v + b u; q counts steps."""

    name: str = "linear"
    dt: float = 1.0
    factor: float = 1.0

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        return q + 1, self.factor * (A * v + B * u)


def process(episode_steps: int = HORIZON, ends: int | None = None, spread: float = 0.0) -> MDP:
    """Start at .3, up to ``spread`` away; reward -(v'^2) - .2 u^2; ``ends``: steps after which an episode is over."""

    def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        return torch.zeros(count, 1, dtype=torch.float64), START + uniform(count, 1, spread, generator)

    return MDP(
        observations=1, actions=1, observe=lambda q, v: v, reset=reset, dt=1.0, episode_steps=episode_steps,
        reward=lambda q, v, u, q_next, v_next: -v_next[:, 0].square() - COST * u[:, 0].square(),
        terminated=never if ends is None else lambda q, v: q[:, 0] >= ends,
    )  # fmt: skip


def truth(gain: float, offset: float, horizon: int = HORIZON) -> np.ndarray:
    """d/d(gain, offset) of the discounted expected return, by the moments of the state."""
    k, c = theta = torch.tensor([gain, offset], dtype=torch.float64, requires_grad=True)
    mean, square = torch.tensor(START, dtype=torch.float64), torch.tensor(START**2, dtype=torch.float64)
    total = torch.zeros((), dtype=torch.float64)
    for t in range(horizon):
        u_square = k**2 * square + 2 * k * c * mean + c**2 + STD**2
        square = A**2 * square + 2 * A * B * (k * square + c * mean) + B**2 * u_square
        mean = A * mean + B * (k * mean + c)
        total = total - DISCOUNT**t * (square + COST * u_square)
    return np.asarray(torch.autograd.grad(total, theta)[0].numpy())


def linear_policy(estimator: str, mdp: MDP, samples: int, **settings: object) -> FOPG:
    """a = W v + b + noise, without the squash's curve: gains as drawn at the start."""
    config = {"std": STD, "discount": DISCOUNT, "horizon": 0, "restart": True} | settings
    config |= {"hidden": (), "squash": "clip", "normalise": False, "samples": samples, "estimator": estimator}
    trainer = FOPG(mdp, Linear(), FOPGConfig(**config))  # type: ignore[arg-type]
    with torch.no_grad():
        for p, value in zip(trainer.policy.net.parameters(), (-0.5, 0.1), strict=True):
            p.fill_(value)
    return trainer


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("ends", [None, 3])
def test_gradient_of_a_linear_quadratic_process(estimator: str, ends: int | None) -> None:
    """Also where episodes are over before the window is: what comes after counts nothing."""
    estimate = linear_policy(estimator, process(ends=ends), 20000).estimate()
    expected = truth(-0.5, 0.1, ends or HORIZON)
    assert np.all(np.abs(estimate.mean - expected) < 4 * np.sqrt(estimate.variance / estimate.samples) + 1e-5)
    assert estimate.standard_error < 0.1 * np.linalg.norm(expected)
    count = 20000 * (ends or HORIZON)
    costs = {"pathwise": (count, count), "zeroth": (count, 0), "aobg": (2 * count, count), "pipps": (count, count)}
    assert (estimate.steps, estimate.derivative_steps) == costs[estimator]


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_windows_that_go_on(estimator: str) -> None:
    """Truncated: two steps of a window, cut by an episode's end into one each: the gradient of one step, twice."""
    trainer = linear_policy(estimator, process(episode_steps=1), 20000, restart=False, horizon=2)
    estimate = trainer.estimate()
    expected = 2 * truth(-0.5, 0.1, 1)
    assert np.all(np.abs(estimate.mean - expected) < 4 * np.sqrt(estimate.variance / estimate.samples) + 1e-5)


def test_variances_come_in_their_order() -> None:
    """On a smooth process: pathwise below total propagation's and AoBG's, score function far above."""
    variance = {e: linear_policy(e, process(), 4000).estimate().total_variance for e in ESTIMATORS}
    assert variance["zeroth"] > 10 * variance["pathwise"]
    assert variance["pipps"] < 1.2 * variance["pathwise"]
    assert variance["aobg"] < 1.2 * variance["pathwise"]


def test_pathwise_is_the_plain_backward_pass() -> None:
    """On the hopper: the mean of the per-sample gradients is what loss.backward() finds."""
    task = load_task("hopper")
    assert task.mdp is not None
    model = ComplementarityModel(task.load_scene(), **task.model_options())
    trainer = FOPG(task.mdp(), model, FOPGConfig(samples=6, horizon=8))
    window = trainer.roll(trainer.simulation)
    plain = torch.autograd.grad(window.total() / 6, list(trainer.policy.net.parameters()), retain_graph=True)
    ours = trainer._pathwise(window)
    np.testing.assert_allclose(ours.mean, torch.cat([g.flatten() for g in plain]), rtol=1e-3, atol=1e-4)
    assert ours.gradients.shape == (6, sum(p.numel() for p in trainer.policy.net.parameters()))


def test_per_sample_gradients_one_by_one() -> None:
    torch.manual_seed(0)
    net = network(3, (5,), 2)
    x, message = torch.randn(4, 6, 3), torch.randn(4, 6, 2)
    rows = per_sample_gradients(net, x, message)
    for k in range(4):
        expected = torch.autograd.grad((net(x[k]) * message[k]).sum(), list(net.parameters()))
        torch.testing.assert_close(rows[k], torch.cat([g.flatten() for g in expected]))


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_learns(estimator: str) -> None:
    """The gain of the optimal feedback of the undisturbed process, by its Riccati equation, within a fifth."""
    mdp = process(episode_steps=8, spread=0.3)
    trainer = linear_policy(estimator, mdp, 64, iterations=80, rate=0.05, discount=1.0)
    metrics = [trainer.update() for _ in range(80)]
    p = 1.0
    for _ in range(100):
        gain = -A * B * p / (COST + B**2 * p)
        p = 1.0 + COST * gain**2 + (A + B * gain) ** 2 * p
    weight, offset = (x.item() for x in trainer.policy.net.parameters())
    assert weight == pytest.approx(gain, rel=0.2)
    assert offset == pytest.approx(0.0, abs=0.05)
    first, last = (np.mean([m["return"] for m in part]) for part in (metrics[:5], metrics[-5:]))
    assert last > first
    assert all(m["gradient_variance"] > 0 for m in metrics)
    assert metrics[-1]["steps"] == 80 * 64 * 8 * (2 if estimator == "aobg" else 1)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("kind", ["gaussian", "bundle", "bcg"])
def test_goes_on_bit_for_bit(estimator: str, kind: str) -> None:
    task = load_task("hopper")
    assert task.mdp is not None
    mdp, scene = task.mdp(), task.load_scene()
    options = {"bundle": {"samples": 2}, "bcg": {"trigger": 1.0, "branches": 2}}.get(kind, {})
    config = FOPGConfig(
        samples=4,
        horizon=4,
        estimator=estimator,
        noise_linear=0.01,
        parameter_spread=0.1,
        hidden=(8,),  # type: ignore
    )

    def make() -> FOPG:
        model = ComplementarityModel(scene, **task.model_options())
        return FOPG(mdp, derivative_model(model, kind, **options), config, seed=1)

    through, stopped, resumed = make(), make(), make()
    for _ in range(2):
        through.update()
        stopped.update()
    resumed.restore(stopped.state())
    for _ in range(2):
        a, b = through.update(), resumed.update()
        a.pop("failures"), b.pop("failures")  # of the model, which counts what it has solved itself
        assert a == pytest.approx(b, rel=0, abs=0, nan_ok=True)
    for one, other in zip(through.policy.parameters(), resumed.policy.parameters(), strict=True):
        assert torch.equal(one, other)


def test_aobg_with_a_bound_of_nothing_is_zeroth_order() -> None:
    trainer = linear_policy("aobg", process(), 64, bias=0.0)
    assert trainer.update()["first_order_weight"] == 0.0


def test_derivative_of_the_command_line() -> None:
    task = load_task("hopper")
    model = ComplementarityModel(task.load_scene(), **task.model_options())
    assert with_derivative(model, "gaussian:length=2e-3", 0, refits=True).backward_smoothing == Gaussian(2e-3)
    assert with_derivative(model, "bcg:branches=4", 0, refits=False).config.branches == 4
    with pytest.raises(UserError, match="fits its model"):
        with_derivative(model, "bcg", 0, refits=True)
    with pytest.raises(UserError, match="only to a contact model"):
        with_derivative(Linear(), "gaussian", 0, refits=False)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_the_critic_values_open_ends_and_learns(estimator: str) -> None:
    """The window's last reward holds the discounted value; the critic's loss falls while the policy stands still."""
    trainer = linear_policy(
        estimator, process(episode_steps=50, spread=0.3), 64, restart=False, horizon=4, critic=True, rate=0.0,
        normalise=True, critic_rate=1e-2,
    )  # fmt: skip
    assert trainer.critic is not None
    trainer.critic.units.deviation = torch.tensor(10.0)  # until the first window is learned, values are 0
    window = trainer.roll(trainer.simulation)
    open_ends = [~s.terminated if k == 3 else s.truncated for k, s in enumerate(window.steps)]
    discount = torch.ones(64, dtype=torch.float64)
    for step, reward, ends in zip(window.steps, window.rewards, open_ends, strict=True):
        value = trainer.critic.value(step.next_observation.float()).double()
        expected = discount * (step.reward + torch.where(ends, DISCOUNT * value, 0.0))
        torch.testing.assert_close(reward, expected, rtol=1e-5, atol=1e-5)  # the critic is float32
        discount = torch.where(step.truncated, 1.0, DISCOUNT * discount)
    losses = [trainer.update()["critic_loss"] for _ in range(60)]
    assert np.mean(losses[-10:]) < 0.2 * losses[0]


@pytest.mark.parametrize("make", [lambda: linear_policy("pathwise", process(), 4), lambda: shac()])
def test_the_caller_s_random_numbers_are_untouched(make: Callable[[], Trainer]) -> None:
    """And weights depend on the seed alone."""
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    trainer = make()
    trainer.update()
    assert torch.equal(torch.rand(4), expected)
    again = make()
    again.update()
    for a, b in zip(trainer.policy.parameters(), again.policy.parameters(), strict=True):
        assert torch.equal(a, b)


def shac() -> SHAC:
    config = SHACConfig(environments=4, horizon=3, noise_linear=0.0, noise_angular=0.0)
    return SHAC(process(), Linear(), config)


def test_the_noise_falls_where_an_end_is_given() -> None:
    assert [FOPGConfig(std=0.4, std_end=0.1).noise_std(p) for p in (0.0, 0.5, 1.0)] == pytest.approx([0.4, 0.2, 0.1])
    assert FOPGConfig(std=0.4).noise_std(1.0) == 0.4
    with pytest.raises(UserError, match="cannot fall"):
        FOPGConfig(std=0.0, std_end=0.1)
    with pytest.raises(UserError, match="must be below 1"):
        FOPGConfig(critic=True, discount=1.0)


def test_refusals() -> None:
    with pytest.raises(UserError, match="did you mean 'pathwise'"):
        FOPG(process(), Linear(), FOPGConfig(estimator="pathwis"))  # type: ignore[arg-type]
    with pytest.raises(UserError, match="needs noise"):
        FOPG(process(), Linear(), FOPGConfig(estimator="zeroth", std=0.0))


def test_a_model_that_breaks_is_given_up() -> None:
    trainer = linear_policy("pathwise", process(), 4)
    trainer.model.factor = float("nan")  # type: ignore[attr-defined]
    with pytest.raises(Diverged, match="in a row") as error:
        for _ in range(20):
            trainer.update()
    assert error.value.states["v"].shape == (4, 1)
