"""FOPG: policy gradients of returns through the model, over whole episodes or windows, by four estimators.

Pathwise (backpropagation through time), score function, their bounded mixture (AoBG), and total propagation (PIPPS):
methods of :mod:`cmbrl.gradients` on a policy net. Each is a choice of messages to the net's outputs, one for each
sample and step, of which the per-sample gradients follow; mean, variance and cost are those of an ``Estimate``.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from cmbrl.envs.mdp import MDP
from cmbrl.envs.simulation import Disturbance, Simulation, parameter_sets
from cmbrl.errors import UserError, did_you_mean
from cmbrl.gradients.aobg import BiasBound, aobg
from cmbrl.gradients.estimate import Estimate
from cmbrl.gradients.kinds import steps_taken
from cmbrl.gradients.per_sample import per_sample_gradients
from cmbrl.gradients.pipps import Future, NoisyNode
from cmbrl.gradients.score import leave_one_out
from cmbrl.models.protocol import Model
from cmbrl.train.policy import Architecture, Policy
from cmbrl.train.trainer import Diverged, episode_metrics

ESTIMATORS = ("pathwise", "zeroth", "aobg", "pipps")
PATIENCE = 10  # updates in a row without a usable gradient, before a run is given up


@dataclass(frozen=True)
class FOPGConfig:
    """Defaults are our choice: SHAC's window without a critic."""

    iterations: int = 500  #: updates of the policy
    samples: int = 64  #: episodes side by side; AoBG takes twice as many, half of them for either order
    horizon: int = 32  #: steps of a window; 0: a whole episode
    restart: bool = False  #: start every window anew (full horizon), instead of where the last one ended (truncated)
    estimator: Literal["pathwise", "zeroth", "aobg", "pipps"] = "pathwise"
    discount: float = 0.99
    hidden: tuple[int, ...] = (32, 32)
    norm: bool = True  #: LayerNorm in the net
    normalise: bool = True  #: standardise observations
    squash: Literal["tanh", "clip"] = "tanh"  #: how the net's output is brought into [-1, 1]: "tanh" or "clip"
    rate: float = 2e-3  #: Adam's; falls linearly to 0
    clip: float = 1.0  #: largest norm of a gradient
    std: float = 0.2  #: of the noise on the net's output; only pathwise can do without
    bias: float = math.inf  #: AoBG's gamma: largest bias allowed; inf: pure inverse variance
    bias_delta: float = 0.05  #: probability with which that bound may fail
    bias_scale: float = 1.0  #: bound on a zeroth-order sample, in units of the gradient
    noise_linear: float = 0.0  #: velocity noise of each step [m/s]
    noise_angular: float = 0.0  #: [rad/s]
    parameter_spread: float = 0.0  #: physical parameters of each episode, relative: 0.2 is +-20 %


@dataclass(frozen=True)
class Window:
    """What a rollout of H steps left, (H, N, ...): the net's ``inputs``, its outputs, what was added to them, rewards.

    ``rewards`` are discounted from the start of the window or of the episode; ``ended`` says where an episode did.
    """

    inputs: Tensor
    outputs: list[Tensor]
    noise: Tensor  # of unit deviation; 0 for samples that are over
    rewards: list[Tensor]
    ended: list[Tensor]
    futures: list[Future]

    def total(self) -> Tensor:
        """Sum over samples and steps."""
        return torch.stack(self.rewards).sum()

    def returns_to_go(self) -> list[Tensor]:
        """Discounted rewards (N,) from each step to the end of its episode or of the window."""
        following = torch.zeros_like(self.rewards[0])
        found = []
        for reward, ended in zip(reversed(self.rewards), reversed(self.ended), strict=True):
            following = reward.detach() + torch.where(ended, 0.0, following)
            found.append(following)
        return found[::-1]


class FOPG:
    """``update`` is one window (AoBG: two) and one step of Adam."""

    def __init__(self, mdp: MDP, model: Model, config: FOPGConfig, seed: int = 0) -> None:
        self.mdp, self.model, self.config = mdp, model, config
        if config.estimator not in ESTIMATORS:
            raise UserError(f"unknown estimator {config.estimator!r}: {did_you_mean(config.estimator, ESTIMATORS)}")
        if config.estimator != "pathwise" and not config.std > 0:
            raise UserError(f"estimator {config.estimator!r} with std = {config.std}: it needs noise on the actions")
        torch.manual_seed(seed)  # initial weights
        self.generator = torch.Generator().manual_seed(seed)
        table = parameter_sets(model, config.parameter_spread, seed=seed)
        disturbance = Disturbance(config.noise_linear, config.noise_angular, table)
        self.horizon = config.horizon or mdp.episode_steps
        count = 2 if config.estimator == "aobg" else 1
        self.simulations = [
            Simulation(mdp, model, config.samples, seed + 7919 * k, disturbance, stagger=not config.restart)
            for k in range(count)
        ]
        self.simulation = self.simulations[0]
        shape = {"hidden": config.hidden, "norm": config.norm, "squash": config.squash, "normalise": config.normalise}
        self.policy = Policy(Architecture(mdp.observations, mdp.actions, **shape))  # type: ignore[arg-type]
        self.policy.normaliser.update(self.simulation.observe().float())
        self.optimiser = torch.optim.Adam(self.policy.net.parameters(), config.rate)
        self.weight = math.nan  #: AoBG's share of the first order
        self.iteration = self.unusable = 0
        self._seen: list[Tensor] = []

    def update(self) -> dict[str, float]:
        """One update; returns its metrics. Raises Diverged when gradients stay unusable."""
        progress = min(self.iteration / self.config.iterations, 1.0)
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.rate * (1.0 - progress)
        estimate = self.estimate()
        norm = self._ascend(torch.from_numpy(estimate.mean).float())
        for observations in self._seen:
            self.policy.normaliser.update(observations[torch.isfinite(observations).all(dim=1)])
        self._seen.clear()
        self.iteration += 1
        metrics = {
            "gradient_norm": norm,
            "gradient_variance": estimate.total_variance,
            "failed_samples": float(estimate.failed),
            "failures": float(getattr(self.model, "failures", 0)),
            "steps": float(steps_taken(self.model, sum(s.steps_taken for s in self.simulations))),
        }
        if self.config.estimator == "aobg":
            metrics["first_order_weight"] = self.weight
        return metrics | episode_metrics([episode for s in self.simulations for episode in s.finished])

    def _ascend(self, gradient: Tensor) -> float:
        """One step along the gradient (n,), clipped; returns its norm."""
        norm = float(gradient.norm())
        if not math.isfinite(norm):
            self.unusable += 1
            if self.unusable > PATIENCE:
                raise Diverged(
                    f"FOPG: {self.unusable} gradients in a row were not finite: shorten the horizon, or smooth more",
                    {"q": self.simulation.q.detach().numpy(), "v": self.simulation.v.detach().numpy()},
                )
            return norm
        self.unusable = 0
        parameters = list(self.policy.net.parameters())
        scale = min(1.0, self.config.clip / norm) if norm > 0 else 1.0
        for p, part in zip(parameters, gradient.split([p.numel() for p in parameters]), strict=True):
            p.grad = -scale * part.view_as(p)
        self.optimiser.step()
        return norm

    def estimate(self) -> Estimate:
        """Gradient of a window's expected return at the present policy (n,), in the order of the net's parameters."""
        c = self.config
        if c.estimator == "zeroth":
            return self._score(self.simulation)
        if c.estimator == "pipps":
            return self._total_propagation(self.simulation)
        first = self._pathwise(self._roll(self.simulation))
        if c.estimator == "pathwise":
            return first
        bound = BiasBound(c.bias, c.bias_delta, c.bias_scale)
        mixed, self.weight = aobg(first, self._score(self.simulations[1]), bound)
        return mixed

    def _total_propagation(self, simulation: Simulation) -> Estimate:
        """As pathwise, but at every noisy node of the graph path and score message are combined."""
        window = self._roll(simulation, nodes=True)
        for future, value in zip(window.futures, window.returns_to_go(), strict=True):
            future.value = value
        return self._pathwise(window)

    def _pathwise(self, window: Window) -> Estimate:
        """The derivative of the window's return in the net's outputs, with everything that follows from them."""
        messages = torch.autograd.grad(window.total(), window.outputs)
        return self._gathered(window, torch.stack(messages), derivatives=True)

    def _score(self, simulation: Simulation) -> Estimate:
        """Score function with rewards to go, less the mean of the other samples' (their noise is independent)."""
        with torch.no_grad():
            window = self._roll(simulation)
        advantage = torch.stack([value - leave_one_out(value) for value in window.returns_to_go()])
        return self._gathered(window, advantage[..., None] * window.noise / self.config.std, derivatives=False)

    def _gathered(self, window: Window, messages: Tensor, derivatives: bool) -> Estimate:
        inputs = window.inputs.transpose(0, 1)
        gradients = per_sample_gradients(self.policy.net, inputs, messages.float().transpose(0, 1))
        steps = len(window.rewards) * self.config.samples * self.mdp.repeat
        return Estimate(gradients.double().numpy(), steps, steps if derivatives else 0)

    def _roll(self, simulation: Simulation, nodes: bool = False) -> Window:
        """``horizon`` steps with noise on the net's output; with ``nodes`` the noise is a node of total propagation."""
        c, policy = self.config, self.policy
        simulation.detach()
        if c.restart:
            simulation.restart()
        running = torch.ones(c.samples, dtype=torch.bool)  # false once the first episode is over, if windows restart
        discount = torch.ones(c.samples, dtype=torch.float64)
        seen, noises, w = [], [], Window(torch.empty(0), [], torch.empty(0), [], [], [])
        for _ in range(self.horizon):
            observation = simulation.observe()
            output = policy.drive(observation.float())
            noise = torch.randn(output.shape, generator=self.generator) * running[:, None]
            future = Future()
            noisy = NoisyNode.apply(output, noise, c.std, future) if nodes else output + c.std * noise
            step = simulation.step(observation, policy.squash(noisy))
            reward = step.reward + step.shaping
            w.rewards.append(torch.where(torch.isfinite(reward) & running, discount * reward, 0.0))
            ended = step.terminated | step.truncated
            discount = torch.where(ended, 1.0, c.discount * discount)
            running = running & ~ended if c.restart else running
            seen.append(observation.detach().float())
            noises.append(noise)
            w.outputs.append(output)
            w.ended.append(ended)
            w.futures.append(future)
            if not running.any():
                break
        self._seen.append(torch.cat(seen))
        inputs = torch.stack([policy.normaliser(o) if c.normalise else o for o in seen])
        return Window(inputs, w.outputs, torch.stack(noises), w.rewards, w.ended, w.futures)

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on."""
        return {
            "iteration": self.iteration,
            "unusable": self.unusable,
            "policy": self.policy.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "simulations": [simulation.state() for simulation in self.simulations],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Goes on from what ``state`` returned, bit for bit."""
        self.iteration, self.unusable = state["iteration"], state["unusable"]
        self.policy.load_state_dict(state["policy"])
        self.optimiser.load_state_dict(copy.deepcopy(state["optimiser"]))
        self.generator.set_state(state["generator"])
        for simulation, kept in zip(self.simulations, state["simulations"], strict=True):
            simulation.restore(kept)
