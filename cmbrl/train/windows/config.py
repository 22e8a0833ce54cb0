"""Settings of learners on short windows of many episodes, which SHAC and FOPG share."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from cmbrl.envs.history import MOST, observed
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model
from cmbrl.settings import setting
from cmbrl.train.windows.critic import CriticConfig

GROWN = 0.5  # share of the updates after which episodes are as long as they get


@dataclass(frozen=True)
class WindowConfig(CriticConfig):
    """Settings of windows, noise and steps; where a task gives none, `cmbrl.train.recipe` derives them from it."""

    iterations: int = setting(1000, "updates of the policy", least=1)
    again: int = setting(
        0, "how often it learns on for as many updates, while its policy fails in the model; not in loop", least=0
    )
    window: float = setting(0.256, "length of a window [s]; it ends later by as much as commands are late", above=0)
    horizon: int | None = setting(None, "control steps of a window; overrides window", least=1)
    discount: float = setting(0.99, "discount per control step", least=0)
    episode_steps: int | None = setting(
        None, "control steps after which a training episode restarts, if the task does not end it before", least=1
    )
    episode_steps_start: int | None = setting(
        None, "the same at the start; grows evenly to episode_steps until half of the updates are done", least=1
    )
    clip: float = setting(1.0, "largest norm of a policy gradient", least=0)
    optimiser: Literal["adam", "muon"] = setting(
        "adam", "of the policy: adam, or muon, which turns the weights of hidden layers in all directions alike"
    )
    noise_linear: float = setting(0.0, "velocity noise added after each step [m/s]", least=0)
    noise_angular: float = setting(0.0, "velocity noise added after each step [rad/s]", least=0)
    draws: int = setting(
        256, "parameter sets drawn from a fit's posterior, one an episode; 0: the fit alone", least=0, most=1_000_000
    )
    parameter_spread: float = setting(
        0.0, "each episode's physical parameters vary by up to this share, on top of the fit's draws", least=0
    )
    vary: str = setting(
        "",
        "each episode's parameters times factors of its own, one for a name or a group: friction:0.5:1.5,mass:0.9:1.1; "
        "for feet that have to land on harder floors than the file's, softness_scale:0.001:1,softness_time:0.5:1",
    )
    other_law: float = setting(
        0.0,
        "share of the episodes under a contact model's other law; 0.5: for a policy that leans on neither",
        least=0,
        most=1,
    )
    other: Literal["sliding", "mujoco", "file", "auto"] = setting(
        "sliding",
        "which law: sliding (the other one), mujoco (MuJoCo's, in which contacts act once they are closed), file "
        "(MuJoCo's own step of the file), or auto (file where longer steps soften its contacts, else sliding)",
    )
    last_actions: int | None = setting(
        None, "last actions that a policy observes; none: as many as the model's delay and lag hold", least=0, most=MOST
    )

    def process(self, mdp: MDP, model: Model) -> MDP:
        """A task's ``mdp`` as a policy observes it that is trained on ``model``."""
        return observed(mdp, model, self.last_actions)

    def episode(self, mdp: MDP, progress: float = 1.0) -> MDP:
        """``mdp`` with the time limit of training episodes when this share of the updates is done.

        A policy sees mostly states long after a reset. One that falls on its back before it can run may learn to run on
        its back; in short episodes it learns first what follows the reset.
        """
        end = min(mdp.episode_steps, self.episode_steps or mdp.episode_steps)
        start = min(end, self.episode_steps_start or end)
        return replace(mdp, episode_steps=round(start + (end - start) * min(1.0, progress / GROWN)))

    def steps(self, mdp: MDP, late: int = 0) -> int:
        """Control steps of a window in ``mdp``; a ``horizon`` of 0 is a whole episode.

        A ``window`` ends later by the steps that commands are ``late``: what the state at its end does not show yet has
        no gradient. A half-cheetah that is 3 of 10 steps late earned 937 after 150 updates so, and 2,531 with 13.
        """
        if self.horizon is None:
            return max(1, round(self.window / mdp.dt)) + late
        return self.horizon or mdp.episode_steps


def decayed(log_start: float, log_end: float, progress: float) -> float:
    """A positive number that falls geometrically from exp(log_start) to exp(log_end) while progress goes 0 to 1."""
    return math.exp(log_start + progress * (log_end - log_start))
