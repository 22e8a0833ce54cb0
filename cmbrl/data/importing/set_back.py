"""Stretches of a recording that lie on each other in time: a clock was set back while it was logged.

A bag's messages are read in the order of their stamps. Where a clock goes back by some tenths of a second, as time
servers set it, the samples before and after come in between each other, and there are twice as many as elsewhere.
"""

from __future__ import annotations

import numpy as np

_WINDOW = 50  # samples
_DENSER = 0.7  # of the time that so many samples usually take; of two stretches it is a half
_BEFORE = 500  # samples, in which a pause would be that a burst makes up for
_EXTRA = 10  # samples that neither jitter nor a burst after a pause brings


def laid_over(time: np.ndarray, step: float) -> tuple[float, float] | None:
    """From when to when [s] rising times (T,), usually ``step`` apart, hold two stretches; None where they do not.

    A burst that makes up for a pause before it does not count, nor does a rate that stays higher to the end.
    """
    if len(time) < 3 * _WINDOW or step <= 0.0:
        return None
    ahead = np.arange(len(time)) - (time - time[0]) / step  # samples more than there should be
    dense = np.flatnonzero(time[_WINDOW:] - time[:-_WINDOW] < _DENSER * _WINDOW * step)
    if not len(dense):
        return None
    first, last = int(dense[0]), int(dense[-1]) + _WINDOW
    more = float(ahead[last] - ahead[max(0, first - _BEFORE) : first + 1].max())
    if last > len(time) - _WINDOW or more < _EXTRA or len(dense) < 0.5 * (last - first - _WINDOW):
        return None
    return _edges(time, first, last, step, more)


def _edges(time: np.ndarray, first: int, last: int, step: float, more: float) -> tuple[float, float]:
    """The stretch of ``more`` extra samples, a little more than it, between the rows ``first`` and ``last``."""
    middle, half = 0.5 * (time[first] + time[last]), 0.5 * more * step
    room = 0.5 * _WINDOW * step
    return max(float(time[first]), middle - half - room), min(float(time[last]), middle + half + room)
