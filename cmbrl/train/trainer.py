"""What every algorithm is, and how it says that it cannot go on."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Protocol

import numpy as np

from cmbrl.errors import UserError
from cmbrl.train.policy import Policy


class Diverged(UserError):
    """A run that cannot go on; ``states`` are its last ones, for whoever looks for the reason."""

    def __init__(self, message: str, states: dict[str, np.ndarray]) -> None:
        super().__init__(message)
        self.states = states


def episode_metrics(finished: Collection[tuple[float, int]]) -> dict[str, float]:
    """Mean "return" and "length" of episodes (return, length); nothing where none has ended."""
    if not finished:
        return {}
    returns, lengths = zip(*finished, strict=True)
    return {"return": sum(returns) / len(finished), "length": sum(lengths) / len(finished)}


class Trainer(Protocol):
    """One algorithm on one task: ``update`` until ``config.iterations`` are done.

    It may also have ``over``, true when its budget is spent, and ``keep(folder)``, called at every checkpoint, for what
    people will want of it beside the policy.
    """

    policy: Policy
    iteration: int

    def update(self) -> dict[str, float]:
        """One iteration; returns its metrics, "steps" (of the model) among them."""
        ...

    def state(self) -> dict[str, Any]:
        """Nested dicts and lists of tensors, numbers and None: everything that the next update depends on."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Goes on from what ``state`` returned."""
        ...
