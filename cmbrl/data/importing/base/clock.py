"""The clock of a motion capture against that of the robot: how much later its times are, found in the motion itself.

Joints and base move together. While feet stand, the base moves as the joints do; in flight, as momentum is kept: both
make the velocity of the base, in its own axes, a linear function of the joints' velocities, which changes with their
positions. So for every offset between the clocks that function is fitted, and the offset wins at which it leaves least:
first with constant coefficients, then, near the best, with coefficients that are linear in the positions. Where a
gyroscope was logged with the joints it is compared with the rotation of the capture instead, which is far sharper. The
motion is cut into parts of equal motion, since rest tells nothing, and each tells an offset of its own: their spread
says how sure the common one is.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cmbrl.data.smoothing import smooth, smooth_rotations
from cmbrl.errors import UserError
from cmbrl.scene.manifold import quaternion_matrix

PARTS = 4
_COARSE, _FINE, _NEAR = 0.5, 0.2, 8.0  # of the capture's time step: of both searches, and how far the second goes
_THINNED = 3  # of the capture's samples one is enough for the coarse search
_ROWS = 2  # samples of a part for each coefficient
_LEAST_ROWS = 30  # of a part
_REST = 0.1  # share of the motion that rest counts as, where all of a recording is
_OVERLAP = 0.5  # of the capture, at least
_LONGER = 100.0  # times the shorter recording: no two of one run
_TOLD = 0.15  # share of the motion that the best offset explains beyond a typical one
_HALF = 0.5  # share of the motion: an offset that leaves more has to be better than all others
_CLEARER = 0.9  # times what any other offset leaves
REMEDY = "give it by --base-offset SECONDS (0 if both have one clock)"
SAME = 2.0  # steps of the capture: a larger error means that the parts disagree


@dataclass(frozen=True)
class Offset:
    """``seconds`` that the capture's times are later than the robot's for the same event, and the error of that.

    ``sure``: whether the error is small enough to take it.
    """

    seconds: float
    error: float
    sure: bool = True


@dataclass(frozen=True)
class Course:
    """Numbers (T, k) at times (T,) [s] of one clock."""

    time: np.ndarray
    values: np.ndarray

    def at(self, time: np.ndarray) -> np.ndarray:
        """The numbers at ``time``, between samples linearly; NaN outside."""
        return np.column_stack(
            [np.interp(time, self.time, column, left=np.nan, right=np.nan) for column in self.values.T]
        )


def twist(time: np.ndarray, poses: np.ndarray) -> Course:
    """The velocities (T, 6) of a base at ``poses`` (T, 7), linear and angular, in its own axes."""
    dt, one = float(np.median(np.diff(time))), np.zeros(len(time), dtype=np.int64)
    linear = smooth(poses[:, :3], dt, one).rate
    turned = np.einsum("nji,nj->ni", quaternion_matrix(poses[:, 3:]), linear)
    return Course(time, np.hstack([turned, smooth_rotations(poses[:, 3:], dt, one).rate]))


def rates(time: np.ndarray, positions: np.ndarray) -> tuple[Course, Course]:
    """Velocities (T, n) of joints, and with their products with positions (T, n + n^2), if there are enough samples."""
    dt = float(np.median(np.diff(time)))
    found = smooth(positions, dt, np.zeros(len(time), dtype=np.int64))
    centred = found.value - found.value.mean(axis=0)
    products = found.rate[:, :, None] * centred[:, None, :]
    return Course(time, found.rate), Course(time, np.hstack([found.rate, products.reshape(len(time), -1)]))


def offset(base: Course, robot: Course, closer: Course, where: str, most: float = 10.0) -> Offset:
    """How much later the clock of ``base`` is; ``robot`` and ``closer`` are joints (see ``rates``), or a gyroscope.

    Offsets of up to ``most`` [s] from that at which both recordings begin together, and up to half the shorter one.
    It is not sure where parts of the motion disagree. Raises UserError if the motion does not tell: nothing moves
    together, or most of the motion has other causes and another offset explains nearly as much of the rest, as of an
    object that is pushed now and then.
    """
    step = float(np.median(np.diff(base.time)))
    lasting = np.ptp(base.time), np.ptp(robot.time)
    if max(lasting) > _LONGER * min(lasting):
        raise UserError(
            f"{where}: the capture lasts {lasting[0]:.4g} s and the joints {lasting[1]:.4g} s: milliseconds instead of "
            "seconds in the column time of one? Divide it by 1000, or call it time_ms"
        )
    span = min(most, 0.5 * min(lasting))
    start = base.time[0] - robot.time[0]
    wide = np.arange(-span, span + 1e-12, _COARSE * step) + start
    few = Course(base.time[::_THINNED], base.values[::_THINNED])
    left = np.array([_unexplained(few, robot, shift) for shift in wide])
    best = float(wide[np.nanargmin(left)])
    typical = float(np.nanmedian(left))
    if not np.nanmin(left) < typical - _TOLD:
        raise UserError(f"{where}: base and joints hardly move together, so the offset of the clocks is open: {REMEDY}")
    least, other = float(np.nanmin(left)), _elsewhere(left, typical)
    if least > _HALF and least > _CLEARER * other:
        raise UserError(
            f"{where}: joints explain {1 - least:.0%} of how the body moves where its clock is {best:.3g} s later, and "
            f"{1 - other:.0%} at another offset, so neither is told: {REMEDY}"
        )
    parts = _parts(base)
    if _ROWS * closer.values.shape[1] < min(len(part.time) for part in parts):
        robot = closer
    near = best + np.arange(-_NEAR, _NEAR + 1e-12, _FINE) * step
    together = lowest(near, np.array([_unexplained(base, robot, shift) for shift in near]))
    told = [lowest(near, np.array([_unexplained(part, robot, shift) for shift in near])) for part in parts]
    error = float(np.std(told, ddof=1) / np.sqrt(PARTS))
    return Offset(together, error, error <= SAME * step)


def _elsewhere(left: np.ndarray, typical: float) -> float:
    """The lowest of a curve outside of the valley around its lowest point, whose sides rise halfway to ``typical``."""
    k = int(np.nanargmin(left))
    high = np.flatnonzero(~(left < 0.5 * (left[k] + typical)))
    first, last = high[high < k].max(initial=-1), high[high > k].min(initial=len(left))
    others = np.concatenate([left[: first + 1], left[last:]])
    return float(np.nanmin(others, initial=np.inf))


def _parts(base: Course) -> list[Course]:
    """``base`` in PARTS that move about as much, of as many samples at least as tell anything."""
    count = len(base.time)
    moved = np.abs(base.values - np.median(base.values, axis=0)) / np.maximum(base.values.std(axis=0), 1e-12)
    share = np.cumsum(moved.sum(axis=1))
    share = (1.0 - _REST) * share / max(share[-1], 1e-12) + _REST * np.arange(1, count + 1) / count
    cuts = np.searchsorted(share, np.arange(1, PARTS) / PARTS)
    least = min(_LEAST_ROWS, count // PARTS)
    for k in range(PARTS - 1):  # from both ends, so that each has its samples
        cuts[k] = max(cuts[k], (k + 1) * least, cuts[k - 1] + least if k else 0)
    for k in reversed(range(PARTS - 1)):
        cuts[k] = min(cuts[k], (cuts[k + 1] if k + 2 < PARTS else count) - least)
    edges = [0, *cuts.tolist(), count]
    return [Course(base.time[a:b], base.values[a:b]) for a, b in pairwise(edges)]


def _unexplained(base: Course, robot: Course, shift: float) -> float:
    """Share of the base's motion that no linear function of the robot's explains, if its clock is ``shift`` later.

    The geometric mean over coordinates, so that those count most that are explained best.
    """
    told = robot.at(base.time - shift)
    rows = np.isfinite(told).all(axis=1)
    if rows.sum() < max(_LEAST_ROWS, _ROWS * told.shape[1], _OVERLAP * len(base.time)):
        return np.nan
    x, y = told[rows], base.values[rows]
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    x, y = x / np.maximum(x.std(axis=0), 1e-12), y / np.maximum(y.std(axis=0), 1e-12)
    rest = y - x @ np.linalg.lstsq(x, y, rcond=1e-6)[0]
    return float(np.exp(np.log(np.maximum((rest**2).mean(axis=0), 1e-9)).mean()))


def lowest(shifts: np.ndarray, left: np.ndarray) -> float:
    """The lowest point of a curve, by the parabola through its neighbours."""
    k = int(np.clip(np.nanargmin(np.where(np.isfinite(left), left, np.inf)), 1, len(shifts) - 2))
    a, b, c = left[k - 1], left[k], left[k + 1]
    bend = a - 2.0 * b + c
    inside = 0.5 * (a - c) / bend if np.isfinite(bend) and bend > 0.0 else 0.0
    return float(shifts[k] + np.clip(inside, -1.0, 1.0) * (shifts[1] - shifts[0]))
