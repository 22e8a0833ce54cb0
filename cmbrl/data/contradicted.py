"""Velocities that positions contradict.

A velocity repeats in free flight, and leaves its neighbours for a sample at an impact, as a lost reading does. What its
position moves by meanwhile tells them apart.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.stretches import stretches

_CLOSER = 0.25  # of how far a velocity is from what its position moved by, its replacement may be
_TELLS = 6.0  # times what positions and velocities usually differ by: two velocities that differ by less look the same
_USUAL = 0.9  # of the rows differ by no more: the rest may be impacts


def contradicted(
    lost: np.ndarray,
    v: np.ndarray,
    mended: np.ndarray,
    moved: np.ndarray,
    dt: np.ndarray | float,
    untold: np.ndarray | None = None,
) -> np.ndarray:
    """Mask (T,) of those of the ``lost`` samples of velocities ``v`` (T,) that positions contradict.

    ``mended`` (T,) takes their place, and fits what the position ``moved`` by, (T - 1,) over ``dt`` [s] from row to
    row, far better: up to the last of the samples, and from the first of them on. An impact between two rows looks like
    a lost reading from one side only. ``untold``: those that are lost where positions do not tell; None: none is.
    """
    own, other = (np.concatenate([[0.0], np.cumsum(moved - 0.5 * dt * (x[1:] + x[:-1]))]) for x in (v, mended))
    sound = ~(lost[1:] | lost[:-1])
    usual = float(np.quantile(np.abs(np.diff(own)[sound]), _USUAL)) if sound.any() else np.inf
    found = np.zeros_like(lost)
    for first, end in stretches(lost):
        spans = [span for span in ((first - 1, end - 1), (first, end)) if span[0] >= 0 and span[1] < len(v)]
        told = [
            abs(other[b] - other[a]) < _CLOSER * abs(own[b] - own[a])
            for a, b in spans
            if abs((own - other)[b] - (own - other)[a]) > _TELLS * usual
        ]
        if told:
            found[first:end] = all(told)
        elif untold is not None:
            found[first:end] = untold[first:end]
    return found
