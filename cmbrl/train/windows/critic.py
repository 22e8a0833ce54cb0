"""The critic that values the ends of windows: a net, a target that follows it slowly, and TD(lambda) regression.

Xu et al., "Accelerated Policy Learning with Parallel Differentiable Simulation" (ICLR 2022), section 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from cmbrl.envs.simulation import Step
from cmbrl.errors import UserError
from cmbrl.settings import setting
from cmbrl.train.policies.policy import Policy, network
from cmbrl.train.trainer import restore_optimiser
from cmbrl.train.windows.value_units import ValueUnits

if TYPE_CHECKING:
    from cmbrl.train.policies.net import Net

BETAS = (0.7, 0.95)  # of Adam, as in the SHAC paper


@dataclass(frozen=True)
class CriticConfig:
    """Settings of the critic, shared by all algorithms that have one."""

    trace: float = setting(0.95, "lambda of the critic's TD(lambda) targets", least=0)
    critic_hidden: tuple[int, ...] = setting((64, 64), "hidden layers of the critic", least=1, most=8_192)
    critic_rate: float = setting(1e-3, "learning rate of the critic (Adam)", least=0)
    critic_epochs: int = setting(4, "passes of the critic over a window", least=1, most=1_000)
    critic_batches: int = setting(2, "minibatches of each pass", least=1, most=10_000)
    target_share: float = setting(0.2, "share of the old target critic that is kept at each update", least=0)


class Critic:
    """Estimates the discounted return that follows an observation.

    Both nets read observations through the policy's normaliser, and learn targets in units of the targets' own mean and
    deviation (:class:`cmbrl.train.windows.value_units.ValueUnits`). So a reward may have any size, and the nets resolve
    what tells states apart rather than what all have in common.

    Of the last actions that late robots are observed with, values have no derivative. A policy's actions follow from
    its states, so that regression cannot tell what an action does from what goes along with it. On a late cart-pole
    (35 ms, steps of 10 ms, 140 updates) a window's gradient that took this slope had a cosine of -.06 with that of the
    episode going on for 2 s, without it .77; an end without a value has .03.

    Args:
        policy: whose returns are estimated.
        config: see there.
        discount: per step, below 1.
        generator: draws the order of minibatches.
    """

    def __init__(self, policy: Policy, config: CriticConfig, discount: float, generator: torch.Generator) -> None:
        self.config, self.discount, self.generator = config, discount, generator
        self.units = ValueUnits()
        self.normaliser = policy.normaliser
        self.past = policy.architecture.last_actions * policy.architecture.actions  # columns, at the end
        widths = policy.architecture.observations, config.critic_hidden, 1
        self.net, self.target = (cast("Net", network(*widths)) for _ in range(2))
        self.target.load_state_dict(self.net.state_dict())
        self.target.requires_grad_(False)
        self.optimiser = torch.optim.Adam(self.net.parameters(), config.critic_rate, betas=BETAS, fused=True)

    def value(self, observations: Tensor) -> Tensor:
        """(B,) of observations (B, n_o), float32, by the slow target; differentiable in them but for last actions."""
        if self.past:
            own = observations.shape[1] - self.past
            observations = torch.cat([observations[:, :own], observations[:, own:].detach()], dim=1)
        return self.units.value(self.target(self.normaliser(observations))[:, 0])

    def fit(self, steps: Sequence[Step]) -> float:
        """Regression on the TD(lambda) targets of a window; returns the mean loss, 1 for the targets' variance.

        Then the normaliser takes in the window's observations, and the target moves towards the net.
        """
        c = self.config
        observations, targets = self.targets(steps)
        usable = torch.isfinite(observations).all(dim=1) & torch.isfinite(targets)
        observations, targets = observations[usable], targets[usable]
        if not len(targets):  # such an update is skipped, and said
            return math.nan
        self.units.follow(targets, self.net, self.target)
        inputs, goals, total = self.normaliser(observations), self.units.goal(targets), 0.0
        for _ in range(c.critic_epochs):
            order = torch.randperm(len(targets), generator=self.generator)
            for rows in order.chunk(c.critic_batches):
                total += self.net.regress(inputs.index_select(0, rows), goals[rows])
                self.optimiser.step()
        with torch.no_grad():
            for old, new in zip(self.target.parameters(), self.net.parameters(), strict=True):
                old.lerp_(new, 1.0 - c.target_share)
        self.normaliser.update(observations)
        return total / (c.critic_epochs * c.critic_batches)

    @torch.no_grad()
    def targets(self, steps: Sequence[Step]) -> tuple[Tensor, Tensor]:
        """Observations (H B, n_o) of the window and their TD(lambda) targets (H B,), both float32."""
        values = self.value(torch.cat([s.next_observation for s in steps]).float()).view(len(steps), -1)
        terminated, truncated = (
            torch.stack(ends) for ends in zip(*((s.terminated, s.truncated) for s in steps), strict=True)
        )
        gains = finite(torch.stack([s.reward + s.shaping for s in steps]))
        values = torch.where(terminated, 0.0, values)
        share = torch.where(terminated | truncated, 0.0, self.config.trace)  # of the next step's target in this one's
        known = (gains + self.discount * (1.0 - share) * values).float()
        following, targets = values[-1], []
        for here, weight in zip(reversed(known), reversed(self.discount * share), strict=True):
            following = here + weight * following
            targets.append(following)
        return torch.cat([s.observation for s in steps]).float(), torch.cat(targets[::-1])

    def state(self) -> dict[str, Any]:
        """Everything that the next ``fit`` depends on."""
        return {
            "net": self.net.state_dict(),
            "target": self.target.state_dict(),
            "units": self.units.state(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self.net.load_state_dict(state["net"])
        self.target.load_state_dict(state["target"])
        self.units.restore(state["units"])
        restore_optimiser(self.optimiser, state["optimiser"])
        self.generator.set_state(state["generator"])


def check_discount(discount: float) -> None:
    """Raises UserError unless the discount is below 1."""
    if not discount < 1:
        raise UserError(
            f"discount = {discount:g}: must be below 1, because the critic estimates an infinite-horizon return"
        )


def finite(x: Tensor) -> Tensor:
    """x with 0 where it is not finite: the last step of an episode that the solver lost."""
    return torch.where(torch.isfinite(x), x, 0.0)
