"""What positions and velocities of a log tell of their noise without a model (``noise`` has the reasons).

Velocities may be slopes of the log's own positions over a few rows before and after (Savitzky and Golay, Analytical
Chemistry, 1964): an import estimates them so. Across an impact such a slope is neither the velocity before nor the one
after, and a row ahead it has seen what is to be predicted. So they tell where predictions start, with what they leave
of the positions' noise, and are not compared.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene
from cmbrl.scene.records import JointKind

_CLEAR_OF_POSITIONS = 0.1  # clean logs have less than nothing, but for chatter
_TURNING = 1.6  # times the next term: logs without noise reach 1.3
_SURE = 3.0  # standard errors of a correlation
_HALF, _ROWS = 5, 5000  # rows on either side of the middle of a slope at most; rows that tell
_SAME = 0.1  # of the noise that slopes have: what other velocities differ from them by is more
_TINY = 1e-300
_TO_DEVIATION = 1.4826  # of a normal distribution, from its median absolute deviation


def of_positions(scene: Scene, data: Transitions, rows: np.ndarray) -> np.ndarray:
    """Standard deviations (nv,) of the noise of q, by what the velocities of the log leave of its changes."""

    def left(at: np.ndarray, end: float) -> np.ndarray:
        mean = (1.0 - end) * data.v[at] + end * data.v_next[at]
        return scene.difference(data.q[at], data.q_next[at]) - data.dt * mean

    (shared, whole), (_, of_end) = (covariance(left(rows, end), left(rows + 1, end)) for end in (0.5, 1.0))
    next_term = data.dt / 12.0 * spread(data.v[rows] - 2.0 * data.v_next[rows] + data.v_next[rows + 1])
    alike = _measured_alike(scene)
    mean = alike / alike.sum(axis=1, keepdims=True)
    clear = mean @ (shared / np.maximum(whole, _TINY)) > np.maximum(
        _CLEAR_OF_POSITIONS, _SURE / np.sqrt(len(rows) * alike.sum(axis=1))
    )
    clear &= (whole < of_end) & (mean @ shared > mean @ (_TURNING * next_term) ** 2)
    return np.sqrt(np.where(clear, np.maximum(mean @ shared, 0.0), 0.0))


def slopes(scene: Scene, data: Transitions) -> np.ndarray:
    """Rows (nv,) on either side over which velocities are slopes of noisy positions; 0 of others."""
    rows, found = some_of(data.windows(3) + 1, _ROWS), np.zeros(scene.nv, dtype=np.int64)
    noise = of_positions(scene, data, rows) if len(rows) > 1 else np.zeros(scene.nv)
    noise = np.max(np.where(_measured_alike(scene) > 0.0, noise, 0.0), axis=1)
    if not noise.any():
        return found
    for half in range(_HALF, 0, -1):
        middle = some_of(data.windows(2 * half) + half, _ROWS)
        if not len(middle):
            continue
        slope = np.zeros((len(middle), scene.nv))
        for k in range(1, half + 1):
            after, before = data.q_next[middle + k - 1], data.q[middle - k]
            slope += k * (scene.difference(data.q[middle], after) - scene.difference(data.q[middle], before))
        off = np.median(np.abs(data.v[middle] - slope / (data.dt * _squares(half))), axis=0)
        own = of_slopes(np.full(scene.nv, half), noise, data.dt)
        found[(noise > 0.0) & (off < _SAME * own)] = half
    return found


def of_slopes(half: np.ndarray, noise: np.ndarray, dt: float) -> np.ndarray:
    """Standard deviations (nv,) of slopes over ``half`` (nv,) rows on either side of positions with ``noise`` (nv,)."""
    return np.asarray(noise / (dt * np.sqrt(np.maximum(_squares(half), _TINY))))


def _squares(half: np.ndarray | int) -> np.ndarray | float:
    """Of the numbers from -half to half."""
    return half * (half + 1) * (2 * half + 1) / 3.0


def _measured_alike(scene: Scene) -> np.ndarray:
    """(nv, nv): 1 for coordinates of one body that are both slides or both turns, else 0."""
    core = scene.core
    kind = 2 * core.jnt_body + (core.jnt_type == JointKind.SLIDE)
    of_dof = kind[np.searchsorted(core.jnt_vadr, np.arange(core.nv), side="right") - 1]
    return (of_dof[:, None] == of_dof).astype(float)


def covariance(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What neighbours (N, c) have less than nothing in common, and the variances of one: (c,) both."""
    apart, together = spread(first - second), spread(first + second)
    return (apart**2 - together**2) / 4.0, (apart**2 + together**2) / 4.0


def spread(x: np.ndarray) -> np.ndarray:
    return _TO_DEVIATION * np.median(np.abs(x - np.median(x, axis=0)), axis=0)


def some_of(rows: np.ndarray, most: int) -> np.ndarray:
    return rows[:: max(1, len(rows) // most)]
