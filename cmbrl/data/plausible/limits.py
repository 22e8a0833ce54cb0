"""Positions and targets against the limits of the file: another unit or sign, or a joint that no stop holds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Coordinate, Motion
from cmbrl.data.plausible.units import DEGREES, LENGTHS
from cmbrl.data.stretches import stretches

OFTEN = 0.3  #: share of samples beyond the limits; a blow throws a joint far beyond them for a few
PAST = 0.05  #: share of samples beyond the limits of a joint that no stop holds
STAYS = 0.1  #: [s] that such a joint stays there; stops of a simulation throw back what is thrown into them
_HARDLY, _OVER = 0.1, 0.05  # of a range: motion in it; what a share may be beyond it


def beyond_limits(motion: Motion) -> Iterator[Finding]:
    """Positions, and targets, far beyond the limits of the file, and within them in another unit."""
    for k, coordinate in enumerate(motion.coordinates):
        if np.isfinite([coordinate.low, coordinate.high]).all() and not motion.wraps[k]:
            degrees = ", or give --angles deg to `cmbrl import`"
            yield from _beyond_limits(motion.now[:, k], coordinate, motion.position_of(k), degrees)
    for m, driver in enumerate(motion.drivers):
        coordinate = motion.coordinates[driver.coordinate]
        if driver.position and np.isfinite([coordinate.low, coordinate.high]).all():
            target = driver.scale * motion.u[:, m]
            degrees = f", or give --map COLUMN={coordinate.name}.command:deg to `cmbrl import`"
            yield from _beyond_limits(target, coordinate, motion.command_of(m), degrees, shares=False)


def _beyond_limits(
    q: np.ndarray, coordinate: Coordinate, column: str, of_degrees: str, shares: bool = True
) -> Iterator[Finding]:
    """The same of one ``column`` q (R,). ``of_degrees``: another remedy; ``shares``: it may be of the range as well."""
    low, high = coordinate.low, coordinate.high
    reach, bound, room = np.abs(q).max(initial=0.0), max(abs(low), abs(high)), 0.1 * (high - low)
    least = 2 * np.pi if coordinate.hinge else 0.0
    often = np.mean((q < low - room) | (q > high + room)) > OFTEN if len(q) else False
    if not (often and reach > max(3 * bound, least)):
        return
    fitting, causes = {}, []
    for factor, unit in ({DEGREES: "degrees"} if coordinate.hinge else LENGTHS).items():
        scaled = q / factor
        if (scaled > low - room).all() and (scaled < high + room).all() and np.ptp(scaled) > 0:
            fitting[unit] = factor, float(np.ptp(scaled)) / (high - low)
    if fitting:
        wanted = "radians" if coordinate.hinge else "metres"
        divide = " or ".join(f"{factor:.4g}" for factor, _ in fitting.values())
        degrees = of_degrees if coordinate.hinge else ""
        causes.append(f"{' or '.join(fitting)} instead of {wanted}? Divide the column by {divide}{degrees}")
    share = _share(q) if shares else None
    if share and max((used for _, used in fitting.values()), default=0.0) < _HARDLY:
        given = f"--map COLUMN={coordinate.name}.position:{share[1]}"
        causes.append(f"{share[0]} of the joint's range? Give {given} to `cmbrl import`, and so for its command")
    if causes:
        yield Finding(
            f"{column} reaches {q[np.abs(q).argmax()]:.4g} where the file's limits are {low:.3g} "
            f"and {high:.3g}: {'; or '.join(causes)}",
            sure=bool(fitting) or not coordinate.hinge,  # a hinge may turn on
        )


def _share(q: np.ndarray) -> tuple[str, str] | None:
    """What ``q`` (R,) may be a share of a range as, and its unit of ``--map``: 0 to 100 or 0 to 1, as grippers tell."""
    for whole, words, unit in ((1.0, "a share, 0 to 1,", "100percent"), (100.0, "percent", "percent")):
        if q.min() > -_OVER * whole and q.max() < (1.0 + _OVER) * whole and np.ptp(q) > _HARDLY * whole:
            return words, unit
    return None


def mirrored(motion: Motion) -> Iterator[Finding]:
    """A warning of joints beyond limits that reach to one side, and within them with the other sign.

    A driver may count the other way, or from another zero: limits do not tell which.
    """
    for k, coordinate in enumerate(motion.coordinates):
        q, low, high = motion.now[:, k], coordinate.low, coordinate.high
        if _mirrored(q, low, high) and not motion.wraps[k]:
            yield Finding(
                f"{motion.position_of(k)} goes from {q.min():.3g} to {q.max():.3g} where the file's limits are "
                f"{low:.3g} and {high:.3g}: does it count the other way, or from another zero? Give --map "
                f"COLUMN={coordinate.name}.position:- (or :+X, what to add) to `cmbrl import`, and so for its command",
                sure=False,
            )


def past_stops(motion: Motion) -> Iterator[Finding]:
    """A warning of joints that go on beyond limits, as those do that turn freely.

    A blow may throw a joint through a stop of a simulation, again and again in a fall, but not for long.
    """
    for k, coordinate in enumerate(motion.coordinates):
        q, low, high = motion.now[:, k], coordinate.low, coordinate.high
        if not np.isfinite(high - low):
            continue
        room = 0.1 * (high - low)
        stays = _for_long((q < low - room) | (q > high + room), motion)
        share = float(stays.mean()) if len(stays) else 0.0
        if share > PAST and not _mirrored(q, low, high) and not motion.wraps[k]:
            yield Finding(
                f"{motion.position_of(k)} goes from {q.min():.3g} to {q.max():.3g}, and in {100 * share:.0f} % of the "
                f"samples lies far beyond the file's limits {low:.3g} and {high:.3g}: in simulation a stop holds what "
                "the robot does not hold. Widen the range in the file, or take it out if the joint turns freely",
                sure=False,
            )


def _for_long(rows: np.ndarray, motion: Motion) -> np.ndarray:
    """Those of the ``rows``, a mask (R,), that last: STAYS, or all of a stretch of the log."""
    found, least = np.zeros_like(rows), STAYS / motion.dt
    for block in motion.blocks:
        for begin, end in stretches(rows[block]):
            if end - begin >= min(least, len(rows[block])):
                found[block.start + begin : block.start + end] = True
    return found


def _beyond(q: np.ndarray, low: float, high: float) -> float:
    """Share of ``q`` (R,) that lies beyond limits by more than a tenth of the range; 0 without limits."""
    room = 0.1 * (high - low)
    return float(np.mean((q < low - room) | (q > high + room))) if np.isfinite(room) and len(q) else 0.0


def _mirrored(q: np.ndarray, low: float, high: float) -> bool:
    """Whether ``q`` (R,) lies beyond limits that reach to one side, and within them with the other sign."""
    room = 0.1 * (high - low)
    one_sided = low > -room or high < room
    return one_sided and _beyond(q, low, high) > OFTEN and _beyond(-q, low, high) == 0.0
