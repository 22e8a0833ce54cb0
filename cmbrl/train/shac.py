"""SHAC: short-horizon actor-critic, first-order policy gradients cut at windows, whose ends a critic values.

Xu et al., "Accelerated Policy Learning with Parallel Differentiable Simulation" (ICLR 2022). Of its own here: what
keeps a policy from living off a fitted model's errors (velocity noise, random parameters, a barrier before the end of
an episode), and exploration noise that follows a schedule instead of being learned.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from typing import Any, Self

import torch
from torch import Tensor, nn

from cmbrl.envs.mdp import MDP
from cmbrl.envs.simulation import Disturbance, Simulation, Step, parameter_sets
from cmbrl.errors import UserError
from cmbrl.gradients.per_sample import per_sample_gradients
from cmbrl.models.protocol import Model
from cmbrl.train.policy import Architecture, Policy, network
from cmbrl.train.trainer import Diverged, episode_metrics

PATIENCE = 10  # updates in a row whose gradient is not finite, before a run is given up


@dataclass(frozen=True)
class SHACConfig:
    """Defaults: the hopper recipe of the reference prototype."""

    iterations: int = 3000  #: updates of the policy
    environments: int = 64  #: episodes side by side
    horizon: int = 32  #: steps of a window
    discount: float = 0.995
    trace: float = 0.95  #: lambda of the critic's TD(lambda) targets
    actor_hidden: tuple[int, ...] = (128, 64)
    critic_hidden: tuple[int, ...] = (64, 64)
    actor_rate: float = 2e-3  #: Adam's; falls linearly to 0
    critic_rate: float = 1e-3
    clip: float = 1.0  #: largest norm of an actor gradient
    tame: float = 5.0  #: an episode's gradient in its state is cut to so many times the median of all; inf: never
    critic_epochs: int = 4  #: passes over a window
    critic_batches: int = 2  #: minibatches of a pass
    target_share: float = 0.2  #: of the old target critic that is kept at each update
    log_std_start: float = -1.0  #: of the exploration noise before the tanh
    log_std_end: float = -2.3
    noise_linear: float = 0.03  #: velocity noise of each step [m/s]
    noise_angular: float = 0.1  #: [rad/s]
    parameter_spread: float = 0.0  #: physical parameters of an episode vary by +- this, beside the model's candidates
    episode_steps: int = 1000  #: after which an episode is cut and begun anew, if the task does not do so before
    variance_every: int = 20  #: updates between measurements of the gradient's variance over episodes

    @classmethod
    def cheetah(cls) -> Self:
        """Shorter windows, for gradients grow over its 50 ms steps; restarts, for it may end up on its back."""
        return cls(iterations=1500, environments=256, horizon=10, discount=0.99, noise_angular=0.3, episode_steps=200)

    def __post_init__(self) -> None:
        if not self.discount < 1:
            raise UserError(f"discount = {self.discount:g}: must be below 1, for a critic values what is endless")

    def noise_std(self, progress: float) -> float:
        """Standard deviation of the exploration noise when this share of the updates is done."""
        return math.exp(self.log_std_start + progress * (self.log_std_end - self.log_std_start))


class SHAC:
    """``update`` is one window and one step of actor and critic; float32 nets over float64 dynamics."""

    def __init__(self, mdp: MDP, model: Model, config: SHACConfig, seed: int = 0) -> None:
        mdp = replace(mdp, episode_steps=min(mdp.episode_steps, config.episode_steps))
        self.mdp, self.model, self.config = mdp, model, config
        torch.manual_seed(seed)  # initial weights
        self.generator = torch.Generator().manual_seed(seed)
        sets = parameter_sets(model, config.parameter_spread, seed=seed)
        disturbance = Disturbance(config.noise_linear, config.noise_angular, sets)
        self.simulation = Simulation(mdp, model, config.environments, seed, disturbance, stagger=True)
        self.policy = Policy(Architecture(mdp.observations, mdp.actions, config.actor_hidden))
        self.critic = Critic(self.policy, config.critic_hidden, scale=1.0 / (1.0 - config.discount))
        self.target = Critic(self.policy, config.critic_hidden, scale=self.critic.scale)
        self.target.net.load_state_dict(self.critic.net.state_dict())
        self.actor_optimiser = torch.optim.Adam(self.policy.net.parameters(), config.actor_rate, betas=(0.7, 0.95))
        self.critic_optimiser = torch.optim.Adam(self.critic.net.parameters(), config.critic_rate, betas=(0.7, 0.95))
        self.iteration = 0
        self.unusable = 0  # updates in a row without a finite gradient
        self.policy.normaliser.update(self.simulation.observe().float())

    def update(self) -> dict[str, float]:
        """One update; returns its metrics. Raises Diverged when gradients stay unusable."""
        progress = min(self.iteration / self.config.iterations, 1.0)
        for group in self.actor_optimiser.param_groups:
            group["lr"] = self.config.actor_rate * (1.0 - progress)
        steps = self._window(progress)
        loss = self._actor_loss(steps)
        self.actor_optimiser.zero_grad()
        loss.backward()
        metrics = self._gradient_metrics(steps)
        if math.isfinite(metrics["gradient_norm"]):
            self.unusable = 0
            self.actor_optimiser.step()
        else:
            self.unusable += 1
            if self.unusable > PATIENCE:
                raise Diverged(
                    f"SHAC: {self.unusable} gradients in a row were not finite: lower rate or horizon, or smooth more",
                    {"q": self.simulation.q.detach().numpy(), "v": self.simulation.v.detach().numpy()},
                )
        metrics["critic_loss"] = self._fit_critic(steps)
        self.iteration += 1
        return metrics | self._episode_metrics()

    def _window(self, progress: float) -> list[Step]:
        """Rolls ``horizon`` steps from where the last window ended, with the graph of this window alone."""
        c, simulation = self.config, self.simulation
        std = c.noise_std(progress)
        simulation.detach()
        steps = []
        for _ in range(c.horizon):
            observation = simulation.observe()
            noise = std * torch.randn(c.environments, self.mdp.actions, generator=self.generator)
            action = self.policy.sample(observation.float(), noise)
            action.retain_grad()
            steps.append(simulation.step(observation, action))
            simulation.q, simulation.v = Tamed.apply(simulation.q, simulation.v, c.tame)
        return steps

    def _actor_loss(self, steps: list[Step]) -> Tensor:
        """Minus the discounted reward of the window per step, plus what the target critic expects after its end."""
        total = torch.zeros((), dtype=torch.float64)
        discount = torch.ones(self.config.environments, dtype=torch.float64)
        ends, weights = [], []  # observations at which an episode goes on unseen, and what they count
        last = len(steps) - 1
        for k, step in enumerate(steps):
            total = total + (discount * finite(step.reward + step.shaping)).sum()
            discount = discount * self.config.discount
            open_end = (~step.terminated).nonzero()[:, 0] if k == last else step.truncated.nonzero()[:, 0]
            if len(open_end):
                ends.append(step.next_observation[open_end])
                weights.append(discount[open_end])
            discount = torch.where(step.terminated | step.truncated, 1.0, discount)
        if ends:
            total = total + (torch.cat(weights) * self.target(torch.cat(ends).float())).sum()
        return -total / (len(steps) * self.config.environments)

    @torch.no_grad()
    def _targets(self, steps: list[Step]) -> tuple[Tensor, Tensor]:
        """Observations (H B, n_o) of the window and their TD(lambda) values (H B,)."""
        c = self.config
        values = self.target(torch.cat([s.next_observation for s in steps]).float()).view(len(steps), -1)
        following = values[-1]
        targets = []
        for step, value in zip(reversed(steps), reversed(values), strict=True):
            mixed = torch.where(step.truncated, value, (1 - c.trace) * value + c.trace * following)
            later = torch.where(step.terminated, 0.0, mixed)
            following = (finite(step.reward + step.shaping) + c.discount * later).float()
            targets.append(following)
        return torch.cat([s.observation for s in steps]).float(), torch.cat(targets[::-1])

    def _fit_critic(self, steps: list[Step]) -> float:
        """Regression on TD(lambda) targets; then the normaliser takes the window in and the target net follows."""
        c = self.config
        observations, targets = self._targets(steps)
        usable = torch.isfinite(observations).all(dim=1) & torch.isfinite(targets)
        observations, targets = observations[usable], targets[usable]
        total = 0.0
        for _ in range(c.critic_epochs):
            order = torch.randperm(len(targets), generator=self.generator)
            for rows in order.chunk(c.critic_batches):
                error = (self.critic(observations[rows]) - targets[rows]) / self.critic.scale
                loss = error.square().mean()
                self.critic_optimiser.zero_grad()
                loss.backward()
                self.critic_optimiser.step()
                total += loss.item()
        with torch.no_grad():
            for old, new in zip(self.target.net.parameters(), self.critic.net.parameters(), strict=True):
                old.lerp_(new, 1.0 - c.target_share)
        self.policy.normaliser.update(observations)
        return total / (c.critic_epochs * c.critic_batches)

    def _gradient_metrics(self, steps: list[Step]) -> dict[str, float]:
        norm = float(nn.utils.clip_grad_norm_(self.policy.net.parameters(), self.config.clip))
        metrics = {"gradient_norm": norm}
        if self.iteration % self.config.variance_every == 0:
            metrics["gradient_variance"] = gradient_variance(self.policy, steps)
        return metrics

    def _episode_metrics(self) -> dict[str, float]:
        steps, failures = self.simulation.steps_taken, getattr(self.model, "failures", 0)
        return {"steps": float(steps), "failures": float(failures), **episode_metrics(self.simulation.finished)}

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on."""
        return {
            "iteration": self.iteration,
            "unusable": self.unusable,
            "policy": self.policy.state_dict(),
            "critic": self.critic.net.state_dict(),
            "target": self.target.net.state_dict(),
            "actor_optimiser": self.actor_optimiser.state_dict(),
            "critic_optimiser": self.critic_optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "simulation": self.simulation.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Goes on from what ``state`` returned, bit for bit."""
        self.iteration, self.unusable = state["iteration"], state["unusable"]
        self.policy.load_state_dict(state["policy"])
        self.critic.net.load_state_dict(state["critic"])
        self.target.net.load_state_dict(state["target"])
        # Adam takes tensors as they are, and would write into the state that it was given.
        self.actor_optimiser.load_state_dict(copy.deepcopy(state["actor_optimiser"]))
        self.critic_optimiser.load_state_dict(copy.deepcopy(state["critic_optimiser"]))
        self.generator.set_state(state["generator"])
        self.simulation.restore(state["simulation"])


class Critic:
    """Value of an observation: a net over the policy's normaliser, times ``scale`` so that its output is about 1."""

    def __init__(self, policy: Policy, hidden: tuple[int, ...], scale: float) -> None:
        self.normaliser, self.scale = policy.normaliser, scale
        self.net = network(policy.architecture.observations, hidden, 1)

    def __call__(self, observations: Tensor) -> Tensor:
        """(B,) of observations (B, n_o), float32."""
        return self.scale * self.net(self.normaliser(observations))[:, 0]


class Tamed(torch.autograd.Function):
    """The identity on states q (B, nq), v (B, nv); backwards, rows longer than ``factor`` medians are cut to that.

    A few episodes that stumble have gradients 10^4 times those of the others, and would be all that an update sees.
    """

    @staticmethod
    def forward(ctx: Any, q: Tensor, v: Tensor, factor: float) -> Any:  # type: ignore[override]
        """The same states."""
        ctx.factor = factor
        return q.view_as(q), v.view_as(v)

    @staticmethod
    def backward(ctx: Any, gq: Tensor, gv: Tensor) -> Any:  # type: ignore[override]
        """Cotangents with their long rows cut."""
        length = torch.cat([gq, gv], dim=1).norm(dim=1)
        share = (ctx.factor * length.nanmedian() / length).clamp(max=1.0).nan_to_num(nan=0.0, posinf=1.0)[:, None]
        return finite(gq) * share, finite(gv) * share, None


def finite(x: Tensor) -> Tensor:
    """x with 0 where it is not finite: the last step of an episode that the solver lost."""
    return torch.where(torch.isfinite(x), x, 0.0)


def gradient_variance(policy: Policy, steps: list[Step]) -> float:
    """Trace of the covariance over episodes of one episode's policy gradient.

    The backward pass has left the loss's total derivative in every action there.
    """
    observations = torch.stack([s.observation.detach().float() for s in steps], dim=1)  # (B, H, n_o)
    messages = torch.stack([_at_drive(s.action) for s in steps], dim=1)
    rows = per_sample_gradients(policy.net, policy.normaliser(observations), messages) * len(observations)
    return float(rows.var(dim=0).sum())


def _at_drive(action: Tensor) -> Tensor:
    """The derivative that the backward pass left at an action, taken through the tanh to the net's output."""
    assert action.grad is not None
    return action.grad * (1 - action.detach().square())
