"""How far a run is along its schedules, from which rates, noise and lengths of episodes follow; and whether it is over.

A hard motion may need twice the updates of an easy one, and a run cannot know that before. So one whose policy still
fails in the model begins its schedules again, halfway: a fight by a G1, which fell in 9 of 20 real episodes after 3,000
updates, fell in none after 3,000 more.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import torch

from cmbrl.envs.trials import LAWS
from cmbrl.train.windows.peak import Peak

LEARNED = 0.5  # where the schedules of a run begin that goes on from a policy, as if so much were done
FAILS = 0.05  # share of failed episodes in the model from which a policy is to learn on


class Schedule:
    """Goes from 0 to 1 in ``updates`` of a run; from LEARNED to 1 in as many where it begins with what was learned.

    Args:
        updates: from its beginning to its end.
        again: how often it may begin again.
        episode: updates that an episode lasts.
    """

    def __init__(self, updates: int, again: int = 0, episode: float = 0.0) -> None:
        self.updates, self.most, self._episode = updates, again, episode
        self.begun = 0.0  #: share that was done at its beginning
        self.first = 0  #: updates of the run before that
        self.peak = Peak(updates, episode)
        self.failing: list[tuple[int, float]] = []  #: updates and share of failed episodes, where it began again
        self._policy: dict[str, torch.Tensor] = {}  # as it was there

    def progress(self, iteration: int) -> float:
        """Share that is done after so many updates of the run."""
        return self.begun + (1.0 - self.begun) * min((iteration - self.first) / self.updates, 1.0)

    @property
    def end(self) -> int:
        """Updates of the run at its end."""
        return self.first + self.updates

    def learned(self) -> None:
        """Begins as with a policy of another run."""
        self.begun = LEARNED

    def conclude(
        self, policy: torch.nn.Module, earned: Callable[[], float], trials: Callable[[], Mapping[str, float]]
    ) -> int | None:
        """At its end: gives the ``policy`` its best weights, and begins again where it fails its ``trials``.

        ``earned``: what it earns; ``trials``: shares of failed episodes in the model, which are asked for only where it
        may begin again. Returns the update whose weights it was given; None where it keeps its own.
        """
        kept = self.peak.iteration if self.peak.give_back(policy, earned) else None
        if not self.most:
            return kept
        shares = trials()
        share = max(shares.get(name, 0.0) for name in LAWS)
        if self.failing and share > self.failing[-1][1]:
            policy.load_state_dict(self._policy)
            return self.first
        if share >= FAILS and len(self.failing) < self.most:
            self.failing.append((self.end, share))
            self._policy = copy.deepcopy(policy.state_dict())
            self.begun, self.first, self.peak = LEARNED, self.end, Peak(self.updates, self._episode)
        return kept

    def state(self) -> dict[str, Any]:
        """Everything that ``restore`` needs."""
        failing = [list(each) for each in self.failing]
        told = {"begun": self.begun, "first": self.first, "failing": failing, "policy": self._policy}
        return {**told, "peak": self.peak.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continues from what ``state`` returned.

        A run that began again, and is given another length now, has that in all.
        """
        self.begun, self.first, self._policy = state["begun"], state["first"], state["policy"]
        self.failing = [(int(update), float(share)) for update, share in state["failing"]]
        self.peak.restore(state["peak"])
        if self.first and not self.most:
            self.updates = max(1, self.updates - self.first)
