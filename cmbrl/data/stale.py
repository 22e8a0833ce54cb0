"""Readings that repeat the last one while a joint moves on: of a sensor slower than the log, or of a late message.

A loop that logs faster than its sensors tell writes such, row after row. Taken for measured they are late, by up to a
period of the sensor; what lies between fresh readings on a straight line is off by far less.

A noisy encoder repeats a reading now and then by chance, as often as it moves by one count only: such are left alone.
A coarse one repeats its readings while a joint moves slowly. Where single rows lie between its counts, as those that an
import has filled in, a count is what lies between the values that come again and again.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

LONGEST = 25  #: rows of one reading; a joint that stays longer may well be at rest
_COUNTS = 4.0  # smallest changes of the column, by which it moves a row: less is what an encoder's counts do
_SLOWER = 0.1  # of a column's rows: then its sensor is slower, and every repetition is one, also where it turns back
_AGAIN = 3  # times that a joint passes a value of an encoder's count
_ROUNDING = 1e-9  # of a column's range, by which equal readings may differ
_FEW = 2.5  # counts that noise moves a reading by about as often as by none
_CLOSER = 0.5  # how much closer to the motion around it a change has to be if it took all the rows, not the last one


def stale(x: np.ndarray) -> np.ndarray:
    """Mask (T,) of the samples of a column (T,) that repeat a reading of something that moves on.

    It moves as fast before as after, and the next reading catches up with that; a joint that rested would not. Where
    there are many, so are all that repeat for as short a time; where noise explains them, none is.
    """
    found, x = np.zeros(len(x), dtype=bool), _rounded(x)
    changed = np.flatnonzero(np.diff(x)) + 1
    if len(changed) < 4:
        return found
    moved, rows = np.diff(x[changed]), np.diff(changed)
    short = (rows > 1) & (rows <= LONGEST)
    if not short.any():
        return found
    rate = moved / rows
    before, here, after = rate[:-2], rate[1:-1], rate[2:]
    around = 0.5 * (before + after)
    count = max(np.abs(moved).min(), _between(x[changed]))
    passes = (before * after > 0.0) & (np.minimum(np.abs(before), np.abs(after)) >= _COUNTS * count)
    goes_on = passes & (here * after > 0.0)
    caught_up = np.abs(here - around) < _CLOSER * np.abs(moved[1:-1] - around)
    own = np.concatenate([[False], goes_on & caught_up, [False]]) & short
    if rows[own].sum() >= _SLOWER * len(x):
        own = short
    elif own.sum() <= (passes & (rows[1:-1] == 1) & (np.abs(moved[1:-1]) < _FEW * count)).sum():
        return found
    for k in np.flatnonzero(own).tolist():
        found[changed[k] + 1 : changed[k + 1]] = True
    return found


def _rounded(x: np.ndarray) -> np.ndarray:
    """``x`` (T,) less what arithmetic has made of equal readings."""
    unit = _ROUNDING * np.ptp(x)
    return unit * np.round(x / unit) if unit > 0.0 else x


def _between(passed: np.ndarray) -> float:
    """The least distance of two values that come again and again among those ``passed`` (k,), if most of them do.

    Else 0: what moves by many counts a row hardly passes one twice.
    """
    values, times = np.unique(passed, return_counts=True)
    often = times >= _AGAIN
    told = often.sum() > 1 and times[often].sum() >= 0.5 * len(passed)
    return float(np.diff(values[often]).min()) if told else 0.0


def stale_rows(columns: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """Mask (T, n) of such samples of ``columns`` (T, n), whose episodes are told by ``episode`` (T,)."""
    found = np.zeros(columns.shape, dtype=bool)
    for first, end in pairwise([0, *(np.flatnonzero(np.diff(episode)) + 1).tolist(), len(columns)]):
        for k in range(columns.shape[1]):
            found[first:end, k] = stale(columns[first:end, k])
    return found


def filled(columns: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """``columns`` (T, n) with the ``lost`` (T, n) samples on straight lines between those before and after them."""
    out, rows = columns.copy(), np.arange(len(columns))
    for k in np.flatnonzero(lost.any(axis=0)).tolist():
        gone = lost[:, k]
        out[gone, k] = np.interp(rows[gone], rows[~gone], columns[~gone, k])
    return out


def fresh_positions(position: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """``position`` (T, n) with what is stale filled in."""
    return filled(position, stale_rows(position, episode))


def fresh_poses(base: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """Poses (T, 7), place and quaternion, with those filled in that repeat the last one while the place moves on."""
    same = np.concatenate([[False], (base[1:] == base[:-1]).all(axis=1)])
    lost = same & stale_rows(base[:, :3], episode).any(axis=1)
    if not lost.any():
        return base
    turned = np.concatenate([[1.0], np.where((base[1:, 3:] * base[:-1, 3:]).sum(axis=1) < 0.0, -1.0, 1.0)])
    poses = np.hstack([base[:, :3], base[:, 3:] * np.cumprod(turned)[:, None]])
    poses = filled(poses, np.broadcast_to(lost[:, None], poses.shape))
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return poses
