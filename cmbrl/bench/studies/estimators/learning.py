"""The learner that every estimator drives: SHAC's nets, critic and schedules around a gradient of any kind.

SHAC itself is first order only and cuts the gradients of single samples; without a critic, windows see too little of an
episode to learn to walk. So FOPG (pathwise, score function, AoBG, PIPPS, on any model) gets SHAC's critic here. Nothing
is cut but the norm of the mean, and learners differ in how they estimate the gradient alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from cmbrl.train.baselines import ARSConfig
from cmbrl.train.fopg import FOPGConfig
from cmbrl.train.shac import SHACConfig


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

    def fopg(self, estimator: str) -> FOPGConfig:
        """The same for FOPG with SHAC's critic; its gradient is of a window's sum, SHAC's of its mean over steps."""
        own = self.shac()
        return FOPGConfig(
            samples=own.environments, horizon=own.horizon, discount=own.discount, rate=own.actor_rate,
            clip=own.clip * self.horizon, estimator=estimator, critic=True, hidden=own.actor_hidden,  # type: ignore[arg-type]
            std=math.exp(own.log_std_start), std_end=math.exp(own.log_std_end), episode_steps=own.episode_steps,
        )  # fmt: skip
