"""SAC: soft actor-critic, Stable-Baselines3's.

Defaults are the library's, except for 10,000 random steps at the start, which RL Baselines3 Zoo
(github.com/DLR-RM/rl-baselines3-zoo) uses for both Hopper and HalfCheetah.
"""

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
class SACConfig:
    """Soft actor-critic, Haarnoja et al. 2018 (arXiv 1812.05905), with a learned temperature."""

    iterations: int = setting(1000, "iterations of the run", least=1)
    block: int = setting(1000, "environment steps of each iteration", least=1)
    environments: int = setting(1, "environments side by side; one update per step of each", least=1, most=1_000_000)
    warmup: int = setting(10_000, "random steps before learning starts", least=1)
    hidden: tuple[int, ...] = setting((256, 256), "hidden layers of actor and critics", least=1, most=8_192)
    rate: float = setting(3e-4, "learning rate", least=0)
    batch: int = setting(256, "size of a batch", least=1)
    buffer: int = setting(1_000_000, "steps kept in the replay buffer", least=1)
    discount: float = setting(0.99, "discount per control step", least=0)
    target_share: float = setting(0.005, "share of the critics that their targets take on at each update", least=0)


class SAC(Baseline):
    """``update`` is ``block`` steps, with an update of the nets after each step of each environment."""

    scales_observations = False

    def make(self, environment: Any, seed: int) -> Any:
        c = self.config
        return sb3.library().SAC(
            "MlpPolicy", environment, seed=seed, device="cpu", learning_rate=c.rate, batch_size=c.batch,
            buffer_size=c.buffer, learning_starts=c.warmup, gamma=c.discount, tau=c.target_share, gradient_steps=-1,
            policy_kwargs={"net_arch": list(c.hidden)},
        )  # fmt: skip

    def architecture(self) -> Architecture:
        hidden = self.config.hidden
        return Architecture.of(self.mdp, hidden, "relu", False, "tanh", False)

    def actor(self) -> Sequence[nn.Module]:
        return [*self.algorithm.actor.latent_pi, self.algorithm.actor.mu]

    def steps(self) -> int:
        return self.config.block
