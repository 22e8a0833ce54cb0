"""Readings that stand alone: for one to three samples a column leaves what surrounds them, as no motion does.

A bus that lost a message, or a counter that ran over, writes such. One of them in a command throws a light body away.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cmbrl.data.stretches import stretches

LONGEST = 3  #: samples
_FAR = 100.0  # times as far from its neighbours' middle as samples usually are; motors' currents get to 25 times
_USUAL = 0.97  # of the samples are no further: the rest may be next to a stray
_BACK = 0.25  # of how far they are, that lies between the samples before and after
_BEYOND = 10.0  # times the range of all others: a command may be a pulse
_LEAST = 1e-4  # rad, m, a second, or N m: nothing is thrown by less, and a joint at rest has velocities of a few digits
_SMALL = 0.02  # of that range: what an encoder's counts do where little moves


def stray(x: np.ndarray, commanded: bool = False) -> np.ndarray:
    """Mask (T,) of the samples of a column (T,) that stand alone.

    What rises or falls, a step among it, is no stray, since medians keep it. ``commanded`` columns may have pulses, and
    only what is far beyond all other commands counts.
    """
    none = np.zeros(len(x), dtype=bool)
    if len(x) <= 2 * LONGEST:
        return none
    bend = np.abs(x[1:-1] - 0.5 * (x[:-2] + x[2:]))
    place = int(_USUAL * (len(bend) - 1))
    least = float(np.partition(bend, place)[place])  # of ``usual``: most columns need no more
    if least > 0.0 and bend.max() <= 0.5 * max(_FAR * least, _LEAST):
        return none
    usual = float(np.quantile(bend, _USUAL))
    if usual <= 0.0 or bend.max() <= 0.5 * max(_FAR * usual, _LEAST):
        return none
    around = sliding_window_view(np.pad(x, LONGEST, mode="edge"), 2 * LONGEST + 1)
    away = np.abs(x - np.median(around, axis=1))
    found = away > max(_FAR * usual, _LEAST)
    if found.any():
        low, high = x[~found].min(), x[~found].max()
        beyond = np.maximum(x - high, low - x) > _BEYOND * (high - low)
        found &= beyond if commanded else away > _SMALL * (high - low)
    return _short(x, away, found)


def _short(x: np.ndarray, away: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Those of the ``found`` (T,) samples in short runs inside the column that come back to where they left."""
    kept = np.zeros_like(found)
    for first, end in stretches(found):
        inside = first > 0 and end < len(x) and end - first <= LONGEST
        if inside and abs(x[end] - x[first - 1]) < _BACK * away[first:end].min():
            kept[first:end] = True
    return kept
