"""Units and signs: degrees for radians, millimetres for metres, velocities against differences of positions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Motion

DEGREES = 180 / np.pi
ANGLES = {DEGREES: "degrees", 1 / (2 * np.pi): "revolutions", 1e3: "milliradians"}  #: numbers in one radian
LENGTHS = {1e3: "millimetres", 1e2: "centimetres"}  #: numbers in one metre
SPEEDS = {DEGREES: "deg/s", 60 / (2 * np.pi): "rpm", 1 / (2 * np.pi): "rev/s"}
NEAR = 0.06  #: relative; two factors are the same, where the columns agree entirely
ROWS = 50  #: fewer do not show how columns go together
WRONG_RATE = 0.15  #: relative; estimated velocities and large steps stay below
SELDOM = 0.5  #: [s] from sample to sample: no encoder that a fit could use is read so seldom
CLOCKS = {1e9: "nanoseconds", 1e6: "microseconds", 1e3: "milliseconds"}  #: numbers in one second
RATES = 1e-4, 0.1  #: [s] steps of logs that robots write
SENSOR_NOISE = 1e-4  #: changes of this size [m, rad] may be noise
ACROSS = 0.85  #: correlation with the derivative of another joint, or of the other sign
MORE_LEFT = 0.1  #: of what a velocity leaves of its own position's motion, that it leaves of another's
SWINGS = 0.01  #: share of rows to either side; a lost whole turn here and there does not count
AGREES = 0.7  #: correlation of two columns that tell the same; impacts within long steps lower it


def clock(dt: float) -> Iterator[Finding]:
    """Samples ``dt`` [s] apart, as in seconds they never are, and in another unit are."""
    for factor, unit in CLOCKS.items():
        if dt >= SELDOM and RATES[0] <= dt / factor <= RATES[1]:
            yield Finding(f"time rises by {dt:.4g} s from row to row: {unit} instead of seconds? Divide by {factor:g}")
            return


def of_commands(motion: Motion, answers: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Iterator[Finding]:
    """Positions that follow their targets by the factor between two units."""
    best, worst, slope = (np.diagonal(array) for array in answers)
    for m, driver in enumerate(motion.drivers):
        if not max(best[m], -worst[m]) > 0.8:
            continue
        hinge = motion.coordinates[driver.coordinate].hinge
        names, wanted = (ANGLES, "radians") if hinge else (LENGTHS, "metres")
        units = [(factor, unit) for factor, unit in names.items() if factor > 1.0]  # a servo may do less than told
        both = motion.position_of(driver.coordinate), motion.command_of(m)
        sizes = np.abs(motion.now[:, driver.coordinate]).max(), np.abs(motion.u[:, m]).max()
        for ratio, size, (column, other) in (
            (abs(slope[m]), sizes[0], both),
            (1 / abs(slope[m]), sizes[1], both[::-1]),
        ):
            for factor, unit in units:
                if abs(ratio / factor - 1) < 0.25 and (size > 2 * np.pi or not hinge):
                    yield Finding(
                        f"{column} moves {ratio:.3g} times as much as {other}: {unit} instead of {wanted}? Divide the "
                        f"column by {factor:.4g}"
                    )


def velocities(motion: Motion) -> Iterator[Finding]:
    """Velocities of another sign, unit, time step or joint than the differences of positions.

    A coordinate that no known fault explains is told by the caller.
    """
    if motion.v_now is None or motion.v_after is None or len(motion.now) < ROWS:
        return
    x, v = motion.change / motion.dt, (motion.v_now + motion.v_after) / 2
    xx, vv = np.sqrt((x * x).sum(axis=0)), np.sqrt((v * v).sum(axis=0))
    rows = np.sqrt(len(x))
    moving = (xx * motion.dt > SENSOR_NOISE * rows) & (vv > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.where(np.outer(moving, moving), (x.T @ v) / np.outer(xx, vv), 0.0)  # (position, velocity)
        own = np.diagonal(r)
        ratio = np.where(moving, vv / xx, np.nan)  # how many of velocity's units are in one of the differences
    yield from _swapped(motion, r)
    for k in np.flatnonzero(own < -ACROSS).tolist():
        yield Finding(
            f"{motion.velocity_of(k)} is minus the derivative of its position (correlation {own[k]:.2f}): a sign "
            "error; negate one of the two columns"
        )
    found = {int(k): told for k in np.flatnonzero(own > AGREES) if (told := _unit(motion, int(k), ratio[k], own[k]))}
    kinds = {motion.coordinates[k].hinge for k in np.flatnonzero(own > AGREES)}
    rate = list(_rate(motion, own, ratio, moving))
    if rate and (len(kinds) > 1 or not found):  # what hinges and slides share is of time
        yield from rate
        return
    for told in found.values():
        yield Finding(told)


def _unit(motion: Motion, k: int, ratio: float, r: float) -> str | None:
    """The unit for which a velocity is ``ratio`` times the change of its position, told; r: their correlation."""
    hinge, near = motion.coordinates[k].hinge, NEAR + 1 / r - 1
    times = f"times the change of {motion.position_of(k)} over dt = {motion.dt:.6g} s"
    for factor, unit in (SPEEDS if hinge else {1e3: "mm/s", 1e2: "cm/s"}).items():
        if abs(ratio / factor - 1) < near:
            wanted = "rad/s" if hinge else "m/s"
            return f"{motion.velocity_of(k)} is {ratio:.3g} {times}: {unit} instead of {wanted}? Convert the column"
    for factor, unit in (ANGLES if hinge else LENGTHS).items():  # then it is the position that is wrong
        if abs(ratio * factor - 1) < near:
            wanted = "radians" if hinge else "metres"
            return (
                f"{motion.position_of(k)} changes {1 / ratio:.3g} times as much as its velocity tells over dt = "
                f"{motion.dt:.6g} s: {unit} instead of {wanted}? Convert the column"
            )
    return None


def _rate(motion: Motion, own: np.ndarray, ratio: np.ndarray, moving: np.ndarray) -> Iterator[Finding]:
    """One factor between velocities and differences, over all joints that move: the time step is wrong.

    Either regression has to say so, of the one on the other and of the other on the one, since noise lowers both.
    """
    clear = own > AGREES
    if not clear.any() or 2 * clear.sum() < moving.sum():
        return
    low, high = ratio[clear] * own[clear], ratio[clear] / own[clear]
    factor = float(np.median(ratio[clear]))
    beyond = (low > 1 + WRONG_RATE) if factor > 1 else (high < 1 - WRONG_RATE)
    same = np.abs(ratio[clear] / factor - 1) < WRONG_RATE
    if beyond.mean() > 0.8 and same.mean() > 0.8:
        k = int(np.flatnonzero(clear)[0])
        yield Finding(
            f"{motion.velocity_of(k)} and {int(same.sum()) - 1} more are {factor:.3g} times the change of position "
            f"over dt = {motion.dt:.6g} s: the wrong rate? Give dt = {motion.dt / factor:.4g} s"
        )


def turns(motion: Motion) -> Iterator[Finding]:
    """Hinges whose angle jumps by whole turns: a warning where it stays within one, and is read as if it went on.

    Beyond one turn it goes on already, so one that swings by more than half a turn from row to row is no angle in
    radians. One that only turns, as a propeller does, may be.
    """
    for k, coordinate in enumerate(motion.coordinates):
        step = motion.after[:, k] - motion.now[:, k]
        if motion.wraps[k]:
            jumps = np.abs(step - motion.change[:, k]) > 1
            yield Finding(
                f"{motion.position_of(k)} jumps by a whole turn in {int(jumps.sum())} rows, first in row "
                f"{np.flatnonzero(jumps)[0]}: read as an angle that goes on",
                sure=False,
            )
        elif coordinate.hinge and min(np.mean(step > np.pi), np.mean(step < -np.pi)) > SWINGS:
            yield Finding(
                f"{motion.position_of(k)} swings by more than half a turn from row to row, {np.abs(step).max():.3g} at "
                "most: degrees instead of radians? Divide the column by 57.3, or give --angles deg to `cmbrl import`"
            )


def _swapped(motion: Motion, r: np.ndarray) -> Iterator[Finding]:
    """Pairs of velocity columns that each tell the motion of the other.

    Joints that move alike, as two wheels do, tell it by what each velocity leaves of either motion.
    """
    own, left = np.diagonal(r), 1.0 - r**2
    for a in range(len(r)):
        for b in np.flatnonzero((r[a, a + 1 :] > ACROSS) & (r[a + 1 :, a] > ACROSS)) + a + 1:
            least = min(left[a, a], left[b, b])
            if max(own[a], own[b]) < ACROSS - 0.3 or max(left[a, b], left[b, a]) < MORE_LEFT * least:
                first, second = motion.coordinates[a].name, motion.coordinates[b].name
                yield Finding(
                    f"v of joints {first!r} and {second!r} are swapped: each is the derivative of the other position"
                )
