"""ARS: augmented random search, that of Stable-Baselines3's contrib with its defaults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torch import nn

from cmbrl.settings import setting
from cmbrl.train.policies.policy import Architecture
from cmbrl.train.rivals import stable_baselines as sb3
from cmbrl.train.rivals.baseline import Baseline


@dataclass(frozen=True)
class ARSConfig:
    """Augmented random search, Mania et al. 2018 (arXiv 1803.07055): a linear policy of scaled observations."""

    iterations: int = setting(500, "iterations of the run", least=1)
    environments: int = setting(
        1, "environments side by side; each direction is tried for an episode in each", least=1, most=1_000_000
    )
    rate: float = setting(0.02, "step size", least=0)
    deviation: float = setting(0.05, "standard deviation of the perturbed weights", least=0)
    directions: int = setting(8, "directions tried in an iteration, each both ways", least=1, most=100_000)
    best: int = setting(8, "directions used, those with the largest returns", least=1)
    alive: float = setting(0.0, "added to each reward: -1 removes a bonus of 1 for staying upright")


class ARS(Baseline):
    """``update`` is one step of the search: an episode of each environment for each direction, both ways."""

    def make(self, environment: Any, seed: int) -> Any:
        c = self.config
        return sb3.library("sb3_contrib").ARS(
            "LinearPolicy", environment, seed=seed, device="cpu", learning_rate=c.rate, delta_std=c.deviation,
            n_delta=c.directions, n_top=c.best, alive_bonus_offset=c.alive, n_eval_episodes=c.environments,
        )  # fmt: skip

    def architecture(self) -> Architecture:
        return Architecture.of(self.mdp, (), "relu", False, "clip", True)

    def actor(self) -> Sequence[nn.Module]:
        return list(self.algorithm.policy.action_net)

    def steps(self) -> int:
        return 1
