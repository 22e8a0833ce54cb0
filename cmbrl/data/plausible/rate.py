"""A rate that is off by some percent, as 1,000 Hz for 1,024: velocities tell it where all joints agree on it.

Over a span from a to b, what positions move by is what velocities add up to, times one factor for all joints, and a lag
of the velocities times what they change by:

    q(b) - q(a) = factor * (integral of v) + lag * (v(b) - v(a))

Noise of either hardly changes the factor over spans of half a second. Impacts, friction and filters differ by joint.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Motion
from cmbrl.data.plausible.still import MEANT
from cmbrl.data.plausible.units import WRONG_RATE

_SPAN = 0.5  # [s]
_ROWS = 50  # spans of a joint at least
_LEAST = 0.01  # of a factor, that is worth a word
_ALIKE = 0.003  # of it, that joints may differ by
_LEFT = 0.03  # of what positions move by
_JOINTS = 2


def off(motion: Motion) -> Iterator[Finding]:
    """A warning of velocities and changes of position that differ by one factor, near 1, in all joints that move."""
    if motion.v_now is None:
        return
    found = [(k, factor) for k in range(len(motion.coordinates)) if (factor := _fine(motion, k)) is not None]
    factors = np.array([factor for _, factor in found])
    if len(found) < _JOINTS:
        return
    middle = float(np.median(factors))
    if not (_LEAST < abs(middle - 1.0) < WRONG_RATE and np.abs(factors - middle).max() < _ALIKE):
        return
    yield Finding(
        f"positions of {motion.coordinates[found[0][0]].name!r} and {len(found) - 1} more move {middle:.4g} times as "
        f"much as their velocities tell over dt = {motion.dt:.6g} s: a rate that is off by "
        f"{100 * abs(middle - 1.0):.2g} %? Then dt is {middle * motion.dt:.6g} s; or all velocities are off by that",
        sure=False,
    )


def _fine(motion: Motion, k: int) -> float | None:
    """The factor of coordinate ``k``, where sums of velocities in steps twice as long lead to the same."""
    fine, coarse = _factor(motion, k, 1), _factor(motion, k, 2)
    return fine if fine is not None and coarse is not None and abs(coarse - fine) < _ALIKE else None


def _factor(motion: Motion, k: int, stride: int) -> float | None:
    """The same by every ``stride``-th row; None where it hardly moves, or where velocities do not tell how."""
    assert motion.v_now is not None
    step, columns = stride * motion.dt, []
    span = max(2, round(_SPAN / step))
    for one in motion.blocks:
        v = motion.v_now[one, k][::stride]
        if len(v) > span:
            moved = np.concatenate([[0.0], np.cumsum(motion.change[one, k][:-1])])[::stride]  # without whole turns
            summed = np.concatenate([[0.0], np.cumsum(0.5 * step * (v[1:] + v[:-1]))])
            columns.append(np.array([x[span:] - x[:-span] for x in (moved, summed, v)]))
    if not columns:
        return None
    y, *x = np.concatenate(columns, axis=1)
    if len(y) < _ROWS or np.ptp(y) < MEANT:
        return None
    solved = np.linalg.lstsq(np.column_stack(x), y, rcond=None)[0]
    left = y - np.column_stack(x) @ solved
    return float(solved[0]) if np.sqrt(np.mean(left**2)) < _LEFT * np.sqrt(np.mean(y**2)) else None
