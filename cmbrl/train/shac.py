"""SHAC: short-horizon actor-critic. First-order policy gradients over short windows, whose ends a critic values.

Xu et al., "Accelerated Policy Learning with Parallel Differentiable Simulation" (ICLR 2022). Two things are our own:
what keeps a policy from exploiting a fitted model's errors (velocity noise, random parameters, a barrier before the end
of an episode), and exploration noise that follows a schedule instead of being learned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from cmbrl.envs.simulation import Step
from cmbrl.gradients.per_sample import per_sample_gradients
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model
from cmbrl.settings import setting
from cmbrl.train.policies.limits import Pinned, at_limits, slope
from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.windows.config import WindowConfig, decayed
from cmbrl.train.windows.critic import BETAS, Critic, check_discount, finite
from cmbrl.train.windows.learner import WindowLearner
from cmbrl.train.windows.lost_gradients import MOST, LostGradients, Usable
from cmbrl.train.windows.trust import bounded_step


@dataclass(frozen=True)
class SHACConfig(WindowConfig):
    """Settings of SHAC."""

    iterations: int = setting(3000, "updates of the policy", least=1)
    environments: int = setting(64, "episodes side by side", least=1, most=1_000_000)
    discount: float = setting(0.995, "discount per control step, below 1", least=0)
    actor_hidden: tuple[int, ...] = setting((128, 64), "hidden layers of the policy", least=1, most=8_192)
    actor_rate: float = setting(2e-3, "learning rate of the policy; falls linearly to 0", least=0)
    trust: float = setting(
        math.inf,
        "largest Kullback-Leibler divergence of the policy from the last one, summed over actions; inf: no bound",
        above=0,
    )
    tame: float = setting(
        5.0,
        "an episode's gradient in its state is cut to this many times the median of all; 1e9: never",
        least=0,
    )
    log_std_start: float = setting(-1.0, "log standard deviation of the exploration noise at the start (before tanh)")
    log_std_end: float = setting(-2.3, "the same at the end")
    saturation: float = setting(
        0.0,
        "cost of a step for the square of what the net's output exceeds +-1 by, before tanh, in units of reward",
        least=0,
    )
    least_slope: float | None = setting(
        None,
        "of tanh to gradients, but to those that press an action at its limit further; 0: tanh's own; none: 0.2 while "
        "most actions are at their limits",
        least=0,
        most=1,
    )
    noise_linear: float = setting(0.03, "velocity noise added after each step [m/s]", least=0)
    noise_angular: float = setting(0.1, "velocity noise added after each step [rad/s]", least=0)
    variance_every: int = setting(20, "updates between measurements of the gradient's variance over episodes", least=1)

    def __post_init__(self) -> None:
        check_discount(self.discount)

    def noise_std(self, progress: float) -> float:
        """Standard deviation of the exploration noise when this share of the updates is done."""
        return decayed(self.log_std_start, self.log_std_end, progress)


class SHAC(WindowLearner):
    """Backpropagates through a window to the policy; gradients of single episodes that explode are cut."""

    title, remedy = "SHAC", "lower actor_rate or window, or smooth more"
    config: SHACConfig
    critic: Critic

    def __init__(self, mdp: MDP, model: Model, config: SHACConfig, seed: int = 0) -> None:
        mdp = config.process(mdp, model)
        generator = torch.Generator().manual_seed(seed)
        super().__init__(
            mdp,
            model,
            config,
            seed,
            architecture=Architecture.of(mdp, config.actor_hidden),
            rate=config.actor_rate,
            betas=BETAS,
            count=config.environments,
            generator=generator,
            critic=generator,
        )
        self.pinned = Pinned()
        self._steps: list[Step] = []

    @property
    def least_slope(self) -> float:
        """Of the present update."""
        return self.pinned.slope if self.config.least_slope is None else self.config.least_slope

    def gradient(self, progress: float) -> dict[str, float]:
        """Rolls a window and leaves its clipped gradient in the policy; see the base class."""
        self._steps = self.roll(progress)
        self.optimiser.zero_grad()
        self.loss(self._steps).backward()
        if self.config.saturation:
            self.restraint(self._steps).backward()
        norm = nn.utils.clip_grad_norm_(self.policy.net.parameters(), self.config.clip)
        lost = self.lost.end_update()
        metrics = {
            "gradient_norm": float(norm) if lost <= MOST else math.nan,
            "lost_gradients": lost,
            "at_limits": at_limits([step.action for step in self._steps]),
        }
        if self.iteration % self.config.variance_every == 0:
            metrics["gradient_variance"] = gradient_variance(self.policy, self._steps, self.least_slope)
        self.pinned.take(metrics["at_limits"])
        return metrics

    def step(self, progress: float) -> dict[str, float]:
        """As in the base class, but not out of the trust region."""
        if math.isinf(self.config.trust):
            return super().step(progress)
        observations = torch.cat([step.observation.detach() for step in self._steps])
        std = self.config.noise_std(progress)
        return {"divergence": bounded_step(self.optimiser, self.policy, observations, std, self.config.trust)}

    def learn(self) -> dict[str, float]:
        """Fits the critic to the last window."""
        steps, self._steps = self._steps, []
        return {"critic_loss": self.critic.fit(steps)}

    def state(self) -> dict[str, Any]:
        """As in the base class, and how pinned its actions are."""
        return super().state() | {"pinned": self.pinned.share}

    def restore(self, state: dict[str, Any]) -> None:
        """As in the base class."""
        super().restore(state)
        self.pinned = Pinned(state["pinned"])

    def roll(self, progress: float) -> list[Step]:
        """A window from where the last one ended, with the graph of this window alone."""
        c, simulation = self.config, self.simulation
        std = c.noise_std(progress)
        simulation.detach()
        least = self.least_slope
        noise = std * torch.randn(self.horizon, c.environments, self.mdp.actions, generator=self.generator)
        moves = []
        with self.policy.held():
            for k in range(self.horizon):
                observation = simulation.observe()
                action = Usable.apply(self.policy.sample(observation.float(), noise[k], least), self.lost)
                action.retain_grad()
                moves.append(simulation.move(observation, action))
                simulation.q, simulation.v = Tamed.apply(simulation.q, simulation.v, c.tame, self.lost)
        return simulation.score(moves)

    def loss(self, steps: list[Step]) -> Tensor:
        """Minus the window's discounted reward and the critic's value of what follows, per step and episode: ()."""
        weight = torch.ones(self.config.environments, dtype=torch.float64)
        weights, rows, left = [], [], []  # of rewards; episodes that continue unseen, and the weights of their values
        for step in steps:
            weights.append(weight)
            weight = weight * self.config.discount
            rows.append(~step.terminated if step is steps[-1] else step.truncated)
            left.append(weight)
            weight = torch.where(step.terminated | step.truncated, 1.0, weight)
        rewards = torch.cat([step.reward + step.shaping for step in steps])
        total = (torch.cat(weights) * finite(rewards)).sum()
        unseen = torch.cat(rows)
        if unseen.any():
            ends = torch.cat([step.next_observation for step in steps])[unseen]
            total = total + (torch.cat(left)[unseen] * self.critic.value(ends.float())).sum()
        return -total / (len(steps) * self.config.environments)

    def restraint(self, steps: list[Step]) -> Tensor:
        """Cost of outputs that tanh flattens, per step and episode at the window's observations: ().

        An action at its limit has neither a gradient nor exploration: a joint that is once pushed into its stop stays.
        """
        drive = self.policy.drive(torch.cat([step.observation.detach() for step in steps]).float())
        excess = (drive.abs() - 1.0).clamp(min=0.0).square().sum(dim=1)
        return self.config.saturation * excess.mean()


class Tamed(torch.autograd.Function):
    """The identity on states q (B, nq), v (B, nv); backwards, rows longer than ``factor`` medians are cut to that.

    Rows that are not finite become 0 and are counted in ``lost``.

    A few episodes that stumble have gradients 10^4 times as long as the others' and would dominate an update.
    """

    @staticmethod
    def forward(ctx: Any, q: Tensor, v: Tensor, factor: float, lost: LostGradients) -> Any:  # type: ignore[override]
        """The same states."""
        ctx.factor, ctx.lost = factor, lost
        return q.view_as(q), v.view_as(v)

    @staticmethod
    def backward(ctx: Any, gq: Tensor, gv: Tensor) -> Any:  # type: ignore[override]
        """Cotangents with their long rows cut."""
        q, v = gq.numpy(), gv.numpy()  # for so few numbers faster than torch
        with np.errstate(all="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", q, q) + np.einsum("ij,ij->i", v, v))
            usable = length < np.inf
            ctx.lost.take("states", usable)
            most = ctx.factor * np.sort(length)[(usable.sum() - 1) // 2]
            share = np.divide(most, length, out=np.ones_like(length), where=length > most)[:, None]
            if not usable.all():
                q, v = (np.where(usable[:, None], g, 0.0) for g in (q, v))
            return torch.from_numpy(q * share), torch.from_numpy(v * share), None, None


def gradient_variance(policy: Policy, steps: list[Step], least_slope: float = 0.0) -> float:
    """Trace of the covariance over episodes of one episode's policy gradient; ``least_slope`` as in the settings.

    Call it after the backward pass, which leaves the loss's total derivative in every action.
    """
    observations = torch.stack([s.observation.detach().float() for s in steps], dim=1)  # (B, H, n_o)
    messages = torch.stack([at_drive(s.action, least_slope) for s in steps], dim=1)
    rows = per_sample_gradients(policy.net, policy.normaliser(observations), messages) * len(observations)
    return float(rows.var(dim=0).sum())


def at_drive(action: Tensor, least_slope: float = 0.0) -> Tensor:
    """The derivative that the backward pass left at an action (B, n_a), taken through tanh to the net's output."""
    assert action.grad is not None
    gradient = finite(action.grad)
    return gradient * slope(action.detach(), gradient, least_slope)
