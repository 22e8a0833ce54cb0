"""The best of a training: a run that loses late what it had learned goes back to it.

First-order gradients through contact may carry a policy away when little is left to learn: of a G1 that learned to
walk, the return fell from 31 after 2,600 updates to 15 after 2,980 of 3,000. The returns of a run's own training
episodes tell that.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import torch

SPAN, MOST = 0.02, 0.125  # shares of a run's updates over which returns are averaged, at least and at most
LEAST = 10  # updates of that
EPISODES = 2  # as many episodes' duration: returns of the last ones tell of policies since the first of them began
LOST = 0.1  # share of the best return below which a run has lost much


class Peak:
    """Follows the mean return of training episodes, and holds the learner as it was before that was highest.

    Episodes that end tell of policies since they began, and a mean of the last updates of earlier ones still: a policy
    that falls at once has already fallen where the mean is highest. So the learner is half a span to a span older.

    Args:
        iterations: updates of the run.
        episode: updates that an episode lasts.
    """

    def __init__(self, iterations: int, episode: float = 0.0) -> None:
        self.span = max(LEAST, round(min(max(SPAN * iterations, EPISODES * episode), MOST * iterations)))
        self.seen = 0  #: updates that the mean is of
        self.begins = 0  #: updates up to which none counts
        self.mean = 0.0  #: of the last updates' returns, older ones counting less and less
        self.best: float | None = None  #: the highest mean
        self.idle: float | None = None  #: mean return of as long episodes without action, once it is asked for
        self.iteration = 0  #: updates of the learner that is held
        self.learner: dict[str, Any] = {}
        self.older: list[Any] = []  # the last learners, half a span apart: their updates, and themselves

    def take(self, iteration: int, returned: float, learner: Callable[[], dict[str, Any]]) -> None:
        """The mean return of the episodes that ended in an update, and what the ``learner`` is after it."""
        if self.waits(iteration):
            return
        self.seen += 1
        self.mean += (returned - self.mean) / min(self.seen, self.span)
        if self.seen % (self.span // 2) == 0:
            self.older = [*self.older[-1:], [iteration, copy.deepcopy(learner())]]
        if self.seen >= self.span and (self.best is None or self.mean > self.best):
            self.best = self.mean
            self.iteration, self.learner = self.older[0]

    def waits(self, iteration: int) -> bool:
        """Whether returns after so many updates are still those of a learner that was left."""
        return iteration <= self.begins

    @property
    def lost(self) -> bool:
        """Whether returns have fallen far below the best ones: by a share of these, or of what they are above ``idle``.

        Rewards that are costs have returns near 0 at best, and a share of that is less than what they vary by.
        """
        if self.best is None or self.seen < self.span:
            return False
        size = abs(self.best) if self.idle is None else max(abs(self.best), self.best - self.idle)
        return self.best - self.mean > LOST * size

    def lost_from(self, idle: Callable[[], float]) -> bool:
        """``lost``, by what no action earns, which is asked for only where it may matter."""
        if self.lost and self.idle is None:
            self.idle = idle()
        return self.lost

    @property
    def open(self) -> bool:
        """Whether a learner went back so lately that its returns do not tell yet whether it is lost."""
        return self.best is not None and self.seen < self.span

    def back(self, iteration: int) -> dict[str, Any]:
        """The learner to go on from after so many updates; episodes that the lost one began are not to count."""
        self.seen, self.mean, self.older, self.begins = 0, 0.0, [], iteration + self.span // 2
        return copy.deepcopy(self.learner)

    def give_back(self, policy: torch.nn.Module, earned: Callable[[], float]) -> bool:
        """Gives the policy its best weights where returns are lost, or it is open whether they are; whether it did.

        Not where it ``earned`` as much with its last ones.
        """
        if not (self.lost or self.open):
            return False
        last = {name: value.clone() for name, value in policy.state_dict().items()}
        by_last = earned()
        policy.load_state_dict(self.learner["policy"])
        if earned() > by_last:
            return True
        policy.load_state_dict(last)
        return False

    def state(self) -> dict[str, Any]:
        """Everything that ``restore`` needs."""
        names = ("seen", "begins", "mean", "best", "idle", "iteration", "learner", "older")
        return {name: getattr(self, name) for name in names}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        for name, value in state.items():
            setattr(self, name, value)
