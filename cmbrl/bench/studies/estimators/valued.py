"""The learner that every estimator drives: SHAC's nets, critic and schedules around a gradient of any kind.

SHAC itself is first order only, and cuts the gradients of single samples; windows without a critic see too little of an
episode to walk. So the windows of FOPG (pathwise, score function, AoBG, PIPPS, on any model) end in SHAC's critic here,
nothing is cut but the norm of the mean, and learners differ in the estimate of one gradient alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import torch
from torch import Tensor

from cmbrl.envs.mdp import MDP
from cmbrl.envs.simulation import Simulation, Step
from cmbrl.models.protocol import Model
from cmbrl.train.baselines import ARSConfig
from cmbrl.train.fopg import FOPG, FOPGConfig
from cmbrl.train.shac import SHAC, SHACConfig


@dataclass(frozen=True)
class Learning:
    """What all estimators share. SHAC's nets, rates and noise are its defaults."""

    samples: int = 64  #: episodes side by side
    horizon: int = 32  #: steps of a window
    discount: float = 0.995
    episode_steps: int = 400  #: after which a training episode is cut
    search: ARSConfig = field(default_factory=ARSConfig)  #: of the random search, which shares only ``episode_steps``

    def shac(self) -> SHACConfig:
        """These settings as SHAC's, on the known scene: without the noise that guards against a model's errors."""
        return SHACConfig(
            environments=self.samples, horizon=self.horizon, discount=self.discount, noise_linear=0.0,
            noise_angular=0.0, episode_steps=self.episode_steps,
        )  # fmt: skip


class Worth(Simulation):
    """A simulation whose rewards know what comes after a window: the value of the observation where it is cut.

    ``horizon``: steps of a window, which ``detach`` begins; ``value``: observations (B, n_o) -> (B,), discounted by
    one step. ``steps`` are those of the window, as the critic learns from them: without that value.
    """

    def __init__(self, horizon: int, value: Callable[[Tensor], Tensor], *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.horizon, self.value = horizon, value
        self.steps: list[Step] = []

    def detach(self) -> None:
        """Begins a window."""
        super().detach()
        self.steps = []

    def step(self, observation: Tensor, action: Tensor) -> Step:
        """The simulation's, with the value of open ends (the window's, or that of a time limit) in the reward."""
        step = super().step(observation, action)
        self.steps.append(step)
        open_end = ~step.terminated if len(self.steps) == self.horizon else step.truncated
        rows = open_end.nonzero()[:, 0]
        if not len(rows):
            return step
        worth = self.value(step.next_observation[rows].float()).double()
        return replace(step, reward=step.reward.index_add(0, rows, worth))


class Valued(FOPG):
    """``update`` is one window of each simulation, one step of Adam along the estimate, and a fit of the critic."""

    def __init__(self, mdp: MDP, model: Model, learning: Learning, estimator: str = "pathwise", seed: int = 0) -> None:
        own = learning.shac()
        self.shac = SHAC(mdp, model, own, seed)
        config = FOPGConfig(
            samples=own.environments, horizon=own.horizon, discount=own.discount, rate=own.actor_rate,
            clip=own.clip * own.horizon, estimator=estimator,  # type: ignore[arg-type]
        )  # fmt: skip
        super().__init__(self.shac.mdp, model, config, seed)
        self.policy, self.optimiser = self.shac.policy, self.shac.actor_optimiser
        self.worths = [
            Worth(own.horizon, self.value, self.mdp, model, own.environments, seed + 7919 * k, stagger=True)
            for k in range(len(self.simulations))
        ]
        self.simulations, self.simulation = [*self.worths], self.worths[0]

    def value(self, observations: Tensor) -> Tensor:
        """(B,) of observations (B, n_o) one step ahead, by the critic that follows slowly."""
        return self.config.discount * self.shac.target(observations)

    def update(self) -> dict[str, float]:
        """One update; returns its metrics. Raises Diverged when gradients stay unusable."""
        progress = min(self.iteration / self.config.iterations, 1.0)
        self.config = replace(self.config, std=self.shac.config.noise_std(progress))
        metrics = super().update()
        return {**metrics, "critic_loss": self.shac._fit_critic(_beside([s.steps for s in self.worths]))}


def _beside(windows: list[list[Step]]) -> list[Step]:
    """Windows of equal length as one of all their rows."""
    return [
        Step(*(torch.cat([getattr(s, f.name) for s in steps]) for f in fields(Step)))
        for steps in zip(*windows, strict=True)
    ]
