"""Whether the published rule beats a rival: paired differences over seeds with their interval, and what follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cmbrl.bench.intervals import interval
from cmbrl.bench.studies.smoothing.cells import Outcome
from cmbrl.bench.studies.smoothing.plan import AIM, EQUAL, REACHED
from cmbrl.gradients.estimate import Array

HITS, DISTANCE = "hits", "distance"


@dataclass(frozen=True)
class Gain:
    """First less second by seed, positive where the first is better, and its mean with the 95 % interval."""

    by_seed: Array
    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, by_seed: Array) -> Gain:
        """From differences by seed."""
        low, high = interval(lambda rows: by_seed[rows].mean(axis=-1), len(by_seed))
        return cls(by_seed, float(by_seed.mean()), low, high)

    @property
    def percent(self) -> str:
        """The mean and its interval."""
        return f"{100 * self.mean:+.1f} [{100 * self.low:+.1f}, {100 * self.high:+.1f}]"

    @property
    def verdict(self) -> str:
        """In the words that were fixed before the runs."""
        if max(-self.low, self.high) <= EQUAL:
            return "refuted: equal"
        if self.low > 0:
            return "repeats"
        return "refuted: worse" if self.high < 0 else "open"


def hits(cell: Outcome, aim: float = AIM) -> Array:
    """Share of launches that end within the aim [m] (seeds,)."""
    return np.mean(_last(cell) < aim, axis=1)  # type: ignore[no-any-return]


def distances(cell: Outcome) -> Array:
    """Mean last distance (seeds,) [m]."""
    return _last(cell).mean(axis=1)  # type: ignore[no-any-return]


def gain(first: Outcome, second: Outcome, measure: str) -> Gain:
    """By ``measure``: HITS, a difference of shares; DISTANCE, a share of the second's mean distance over all seeds."""
    if measure == HITS:
        return Gain.of(hits(first) - hits(second))
    return Gain.of((distances(second) - distances(first)) / distances(second).mean())


def measure_of(arms: Mapping[str, Outcome]) -> str:
    """What decides in a scene: hits, unless no arm has a share of them worth the name."""
    return HITS if max(hits(cell).mean() for cell in arms.values()) >= REACHED else DISTANCE


def _last(cell: Outcome) -> Array:
    return np.array(cell["distances"], dtype=float)[-1]
