"""The ways that a first search goes, where it is open how far the file is off: the best of what they lead to is kept.

Plainly; with a prior that is heavy at first, so that what the log tells best moves first; and by a tolerant loss. Where
contacts make and break, single windows stop the first two: by the plain loss they hide what all others gain. The
tolerant one counts those beyond the usual as little as their logarithm. Usual is the loss of the best fifth, and of
fewer from stop to stop: a search that stops goes on by those that are explained already. All ways end plainly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbrl.fitting.search.gauss_newton import reweighed
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import SOLVER_VARIANCE
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal

_HEAVY = 1e4  # variance that weighs the prior at first: as if errors were 100 times the change
_USUAL = (0.2, 0.1, 0.05)  # shares of the windows
_PASSES = 12  # of a log without noise


@dataclass(frozen=True)
class Ways:
    """Searches of ``loss`` over the ``chosen`` (n,) parameters, by passes of ``iterations``.

    ``noisy``: most of the errors that remain are noise, and a prior that they weigh again would let it be fitted.
    ``every``: not the plain way alone.
    """

    loss: PredictionLoss
    space: Space
    chosen: np.ndarray
    iterations: int
    journal: Journal
    noisy: bool
    every: bool

    def best(self, begin: np.ndarray) -> np.ndarray:
        """Where (n,) the best way leads from the best row of ``begin`` (k, n); no other is tried of what is exact."""
        if not self.chosen.any():
            return begin[0]
        found, lowest = begin[0], np.inf
        values = [self._value(z) for z in begin] if len(begin) > 1 else [0.0]
        for z in self._all(begin[int(np.argmin(values))]):
            value = self._value(z)
            if value < lowest or not np.isfinite(lowest):
                found, lowest = z, value
            if lowest <= 0.5 * SOLVER_VARIANCE * self.loss.windows.scales.observed:
                break
        return found

    def _all(self, begin: np.ndarray) -> Iterator[np.ndarray]:
        yield self._led(begin)
        if not self.every:
            return
        if not self.noisy:
            yield self._led(begin, _HEAVY)
        z, heavy = begin, 0.0 if self.noisy else _HEAVY
        for share in _USUAL:
            z, heavy = self._led(z, heavy, share), 0.0
        yield self._led(z)

    def _led(self, z: np.ndarray, heavy: float = 0.0, usual: float | None = None) -> np.ndarray:
        passes = 1 if self.noisy else _PASSES
        return reweighed(self.loss, self.space, self.chosen, z, self.iterations, self.journal, heavy, passes, usual)

    def _value(self, z: np.ndarray) -> float:
        theta = self.space.theta(z)
        value = float(self.loss.settled(theta).values(theta[None])[0])
        return value if np.isfinite(value) else np.inf
