"""Which of several policies goes on: each is trained to the end or for a trial, and the one that earns most is kept.

What a policy earns is measured in the model, never in the real system, under draws of the fit and without noise: such
returns rank policies as the real system does (rank correlation 0.99 over ten hoppers, against 0.43 with noise). It is
the mean of both laws of sliding and of MuJoCo's step, since no robot slides quite by any.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cmbrl.envs.trials import LAWS, failed, stands, trials, without_action
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.train.policies.policy import Policy


def judged(policy: Policy, mdp: MDP, model: ComplementarityModel, episodes: int, seed: int) -> dict[str, float]:
    """Mean return in the model under its uncertainty, that of its laws too, as "score", and what trials say.

    "failed": the share of episodes that fail under the draws; "stands": 1 if it ``stands``. Whoever hardly moves
    stands, and a policy that would fall under the other law may still be worth more.
    """
    given = mdp, model, episodes, seed
    found = trials(policy, *given)
    shares = failed(found, without_action(*given))
    returns = [found[name].returns.mean() for name in LAWS if name in found]
    told = {"failed": shares["draws"], "stands": float(stands(shares))}
    return {"score": float(np.mean(returns)), **told}


@dataclass
class Contest:
    """Policies of a round, one after another: ``planned`` ones, and up to ``further`` while the best does not stand."""

    planned: int
    further: int
    tried: list[dict[str, Any]] = field(default_factory=list)  #: of each: score, "stands", trainer's state
    added: int = 0  #: policies of all rounds besides those planned
    wanted: int = field(init=False)  #: policies of this round

    def __post_init__(self) -> None:
        self.wanted = self.planned

    @property
    def open(self) -> bool:
        """Whether another policy is to be tried."""
        return len(self.tried) < self.wanted

    @property
    def best(self) -> dict[str, Any]:
        """The policy with the highest score."""
        return max(self.tried, key=lambda one: float(one["score"]))

    def enter(self, found: Mapping[str, float], trainer: dict[str, Any]) -> None:
        """Takes what was ``found`` of a policy, and the state of its trainer; plans another where the best falls."""
        told = {name: found[name] for name in ("score", "stands")}
        self.tried.append({**told, "trainer": copy.deepcopy(trainer)})
        if not self.open and self.wanted < self.planned + self.further and not self.best["stands"]:
            self.wanted, self.added = self.wanted + 1, self.added + 1

    def begin(self) -> None:
        """A round without policies so far."""
        self.tried, self.wanted = [], self.planned

    def told(self, when: str) -> str:
        """What the policies earned by which one was kept."""
        earned = ", ".join(f"{one['score']:.4g}" for one in self.tried)
        return f"of {len(self.tried)} policies the best is kept; in the model they earn, {when}, {earned}"

    def state(self) -> dict[str, Any]:
        """Everything that ``restore`` needs."""
        return {"tried": self.tried, "added": self.added, "wanted": self.wanted}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self.tried, self.added, self.wanted = state["tried"], state["added"], state["wanted"]
