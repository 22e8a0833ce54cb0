"""What all estimators share: the task, and the learner around a gradient of any kind.

SHAC itself is first order only and cuts the gradients of single samples; without a critic, windows see too little of an
episode to learn to walk. So FOPG (pathwise, score function, AoBG, PIPPS, on any model) gets SHAC's critic here. Only
the norm of the mean gradient is cut, and learners differ only in how they estimate the gradient.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.train.fopg import FOPGConfig
from cmbrl.train.shac import SHACConfig


@dataclass(frozen=True)
class Learning:
    """Sizes of windows and episodes. Nets, rates and noise are SHAC's defaults."""

    samples: int = 64  #: episodes side by side
    horizon: int = 32  #: steps of a window
    discount: float = 0.995
    episode_steps: int = 400  #: after which a training episode is cut

    def shac(self) -> SHACConfig:
        """As SHAC's settings, without the noise that guards against errors of a model."""
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


def nominal(name: str) -> tuple[MDP, ComplementarityModel]:
    """The process of a task and its nominal model, hard, on one thread."""
    task = load_task(name)
    assert task.mdp is not None
    return task.mdp(), ComplementarityModel(task.load_scene(), **task.model_options())
