"""The ways that a first search goes, where it is open how far the file is off: the better of both is kept.

Plainly, and by a tolerant loss. Where contacts make and break, single windows stop a plain search: they hide what all
others gain. The tolerant loss counts those beyond the usual as little as their logarithm. Usual is the loss of the best
fifth, then of the best tenth and twentieth: a search that stops goes on by windows that are explained already. It
begins with a prior that is heavy, so that what the log tells best moves first, and ends plainly.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cmbrl.fitting.search.gauss_newton import reweighed
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import SOLVER_VARIANCE
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal, OutOfTime

_HEAVY = 1e4  # variance that weighs the prior at first: as if errors were 100 times the change
_USUAL = (0.2, 0.1, 0.05)  # shares of the windows
_PASSES = 12  # of a log without noise


@dataclass(frozen=True)
class Ways:
    """Searches of ``loss`` over the ``chosen`` (n,) parameters, by passes of ``iterations``.

    ``noisy``: most of the errors that remain are noise, and a prior that they weigh again would let it be fitted.
    ``tolerant``: by that loss, too.
    """

    loss: PredictionLoss
    space: Space
    chosen: np.ndarray
    iterations: int
    journal: Journal
    noisy: bool
    tolerant: bool

    def best(self, begin: np.ndarray) -> np.ndarray:
        """Where (n,) the better way leads from the best row of ``begin`` (k, n).

        The plain one if it is exact, or if time is up for another.
        """
        if not self.chosen.any():
            return begin[0]
        start = begin[0] if len(begin) == 1 else min(begin, key=self._value)
        found = self._led(start)
        if not self.tolerant or self.is_exact(found):
            return found
        value = self._value(found)
        with suppress(OutOfTime):
            other = self._by_tolerant(start)
            found = other if self._value(other) < value else found
        return found

    def is_exact(self, z: np.ndarray) -> bool:
        """Whether the loss at ``z`` (n,) is no more than the solver's accuracy leaves."""
        return self._value(z) <= 0.5 * SOLVER_VARIANCE * self.loss.windows.scales.observed

    def _by_tolerant(self, z: np.ndarray) -> np.ndarray:
        heavy = 0.0 if self.noisy else _HEAVY
        for share in _USUAL:
            z, heavy = self._led(z, heavy, share), 0.0
        return self._led(z)

    def _led(self, z: np.ndarray, heavy: float = 0.0, usual: float | None = None) -> np.ndarray:
        passes = 1 if self.noisy else _PASSES
        return reweighed(self.loss, self.space, self.chosen, z, self.iterations, self.journal, heavy, passes, usual)

    def _value(self, z: np.ndarray) -> float:
        theta = self.space.theta(z)
        value = float(self.loss.settled(theta).values(theta[None])[0])
        return value if np.isfinite(value) else np.inf
