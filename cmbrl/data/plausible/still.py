"""Sensors that stand still while what they measure moves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Motion, white_noise
from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

LONG = 50  #: samples; and RARE times as long as others, so that coarse encoders are no fault
RARE = 10
MEANT = 0.05  #: [rad, m] a target has to move by so much, more than dry friction holds
_OF_RANGE = 0.2  # between the stops, the same
_ON_GRID = 0.02  # of an encoder's count
ONWARDS, ROUNDING = 3.0, 1e-9  #: counts that a coarse encoder goes on by; [rad, m]
_STRETCHES, _ALTERNATES = 8, -0.5  # of LONG samples, to tell noise by; correlation of third differences
_OF_A_DIGIT, _CALMEST = 0.5, 3  # rounding has .3 of the last digit; stretches
_PARTS = 10  # the least change may be several digits
_THIRD = 20.0  # times the variance of white noise is that of its third differences
_JUMPS, _ONWARD = 10.0, 0.2  # times the usual changes; of the jump, that the next change is: a blow goes on
_REPEATS = 0.05  # share of samples that are the one before, of an encoder with counts that was read in between
_AS_FAST = 0.3  # of the usual speed elsewhere
_WALKS = 4.0  # times the root of the samples: what white noise of a velocity adds up to


def stuck(motion: Motion) -> Iterator[Finding]:
    """Columns that repeat one number for long while command or velocity say that the joint moves."""
    driven = {driver.coordinate: m for m, driver in enumerate(motion.drivers)}
    for k in range(len(motion.coordinates)):
        if (run := _longest(_runs(motion.now[:, k]))) is None:
            continue
        where = f"from row {run.start} to {run.stop - 1}"
        if motion.v_now is not None and _goes(motion.v_now[:, k] * motion.dt, run):
            yield Finding(f"{motion.position_of(k)} is constant {where} while its velocity is not 0: a stuck sensor?")
        elif k in driven and _commanded(motion, driven[k], run):
            command, sure = motion.command_of(driven[k]), _would_move(motion, driven[k], run)
            cause = "a stuck sensor?" if sure else "a joint that sticks, or a stuck sensor?"
            yield Finding(f"{motion.position_of(k)} is constant {where} while {command} moves: {cause}", sure=sure)
        elif (k not in driven or np.ptp(motion.u[run, driven[k]]) > 0) and loud(motion.now[:, k], motion.blocks, run):
            # without a command that goes on: see ``joined``
            yield Finding(
                f"{motion.position_of(k)} is constant {where}, without the noise that it has elsewhere: a stuck sensor?"
            )
        elif jump := _catches_up(motion.change[:, k], run):
            yield Finding(f"{motion.position_of(k)} is constant {where}, and then jumps by {jump:.3g}: a stuck sensor?")
        elif k not in driven and (under := _carrier(motion, k, run)) is not None:
            joint = motion.coordinates[under].name
            yield Finding(
                f"{motion.position_of(k)} is constant {where} while joint {joint!r}, which carries it, moves: a joint "
                "that sticks, or a stuck sensor?",
                sure=False,
            )
    if motion.v_now is None:
        return
    for k in range(len(motion.coordinates)):
        run = _longest(_runs(motion.v_now[:, k]))
        if run is not None and _uneven(motion.change[run, k], motion.v_now[run.start, k] * motion.dt):
            yield Finding(
                f"{motion.velocity_of(k)} is constant from row {run.start} to {run.stop - 1} while its position moves: "
                "a stuck sensor?"
            )


def _catches_up(change: np.ndarray, run: slice) -> float:
    """By how much a position jumps after ``run``, in one sample, to where it then goes on slowly; 0 if it does not."""
    jump, further = np.abs(change[run.stop - 1]), np.abs(change[run.stop : run.stop + 1])
    usual = np.quantile(np.abs(np.delete(change, run)), 0.99) if len(change) > run.stop - run.start else np.inf
    alone = len(further) > 0 and further[0] < _ONWARD * jump
    return float(jump) if alone and jump > max(MEANT, _JUMPS * usual) else 0.0


def _runs(x: np.ndarray) -> list[slice]:
    """Stretches of one number, at least two rows long."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(x)) + 1, [len(x)]])
    return [slice(int(edges[k]), int(edges[k + 1])) for k in np.flatnonzero(np.diff(edges) > 1)]


def _longest(runs: list[slice]) -> slice | None:
    """The longest of the runs, if it is long, and much longer than the others usually are."""
    if not runs:
        return None
    lengths = np.array([run.stop - run.start for run in runs])
    longest = int(lengths.argmax())
    others = np.delete(lengths, longest)
    usual = np.percentile(others, 90) if len(others) > 2 else 1
    return runs[longest] if lengths[longest] >= max(LONG, RARE * usual) else None


def _coarse(x: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Changes (T - 1,) of ``x`` in counts of its encoder, and the usual one; None of readings that lie on no grid."""
    steps = np.diff(x)
    moved = np.abs(steps[np.abs(steps) > ROUNDING])
    if not len(moved):
        return None
    counts = steps / moved.min()
    return (counts, float(np.percentile(moved, 90) / moved.min())) if _whole(counts) else None


def _whole(counts: np.ndarray) -> bool:
    return bool(np.abs(counts - np.round(counts)).max() < _ON_GRID)


def _sticks(x: np.ndarray, run: slice) -> bool:
    """Whether a coarse encoder goes on where it was: a joint may stand still for long, held by friction or a stop."""
    grid = _coarse(x)
    if run.stop >= len(x) or grid is None:
        return False
    counts, usual = grid
    return bool(abs(counts[run.stop - 1]) <= max(ONWARDS, usual))


def _would_move(motion: Motion, m: int, run: slice) -> bool:
    """Whether command m, which moves in the rows of ``run``, would move its joint there.

    A target does, and a force that is much of what the motor has, or that moves the joint elsewhere. Less holds a joint
    that the others shake.
    """
    driver = motion.drivers[m]
    place = motion.now[:, driver.coordinate]
    if _sticks(place, run):
        return False
    strong = np.ptp(motion.u[run, m]) > _OF_RANGE * (driver.high - driver.low)
    elsewhere = np.delete(place, run)
    return bool(driver.position or strong or (len(elsewhere) and np.ptp(elsewhere) > MEANT))


def loud(x: np.ndarray, blocks: Iterable[slice], run: slice) -> bool:
    """Whether the sensor of ``x`` (R,) shows noise outside of ``run``, of which no joint's rest is free.

    Third differences of noise alternate, with a correlation of -3/4; those of smooth motion go on. The calmest
    stretches tell it, where motion hides it least. Encoders with counts are quiet at rest; where samples were read in
    between, they lie on no grid, and repeat all the same. So does what was written with six digits, where the calmest
    stretches have no noise but their rounding.
    """
    again = np.abs(np.diff(np.delete(x, run))) < ROUNDING
    if _coarse(x) is not None or (len(again) and again.mean() > _REPEATS):
        return False
    calm = []
    for block in blocks:
        for start in range(block.start, block.stop - LONG + 1, LONG):
            if start >= run.stop or start + LONG <= run.start:
                third = np.diff(x[start : start + LONG], n=3)
                calm.append((float(third @ third), float(third[1:] @ third[:-1])))
    calm.sort()
    square, product = np.sum(calm[: max(len(calm) // 4, 1)], axis=0) if calm else (0.0, 0.0)
    if len(calm) < _STRETCHES or square == 0.0 or product > _ALTERNATES * square:
        return False
    least = np.mean([square for square, _ in calm[:_CALMEST]]) / (_THIRD * (LONG - 3))
    return bool(least > (_OF_A_DIGIT * _digit(x, run)) ** 2)


def _digit(x: np.ndarray, run: slice) -> float:
    """The last digit of ``x`` (R,) as it was written, where it is about what it repeats in ``run``; 0 if none shows."""
    others = np.delete(x, run)
    steps = np.diff(others)[np.argsort(np.abs(others[1:] - x[run.start]))[:LONG]]
    least = np.abs(steps)[np.abs(steps) > ROUNDING].min(initial=np.inf)
    parts = (part for part in range(1, _PARTS + 1) if np.isfinite(least) and _whole(steps * part / least))
    return float(least) / part if (part := next(parts, 0)) else 0.0


def turned(q: np.ndarray, blocks: Iterable[slice], scene: Scene) -> Iterator[Finding]:
    """Quaternions of q (R, nq) that repeat for long, without the noise that they have elsewhere."""
    blocks = list(blocks)
    for joint in scene.joints:
        if joint.kind != JointKind.BALL or not len(q):
            continue
        turn = q[:, joint.qadr : joint.qadr + 4]
        run = _longest(_runs(np.cumsum(np.r_[False, (np.diff(turn, axis=0) != 0).any(axis=1)])))
        if run is not None and any(loud(x, blocks, run) for x in turn.T[1:]):
            name = scene.joint_names[joint.source]
            yield Finding(
                f"the quaternion of {name} is constant from row {run.start} to {run.stop - 1}, without the noise that "
                "it has elsewhere: a stuck sensor?"
            )


def _carrier(motion: Motion, k: int, run: slice) -> int | None:
    """A joint that moves in the rows of ``run`` as elsewhere, and carries coordinate ``k``; None if none does."""
    for other in motion.coordinates[k].above:
        x = motion.now[:, other]
        if np.ptp(x[run]) > MEANT and x[run].std() > 0.3 * x.std():
            return other
    return None


def _travels(steps: np.ndarray) -> bool:
    """Whether velocities, times the time step, lead away by more than noise."""
    return bool(np.ptp(np.cumsum(steps)) > MEANT and np.sqrt(np.mean(steps**2)) > 1e-6)


def _goes(steps: np.ndarray, run: slice) -> bool:
    """Whether velocities, times the time step ``steps`` (R,), say that a joint moves in the rows of ``run``.

    They lead away, as fast as elsewhere, or by more than what a sensor at rest adds up to: an offset that its noise
    hides, and the walk of the noise itself.
    """
    inside, elsewhere = steps[run], np.delete(steps, run)
    if not _travels(inside):
        return False
    if len(elsewhere) >= LONG and inside.std() > _AS_FAST * elsewhere.std():
        return True
    noise = float(white_noise([inside]))
    offset = float(inside.mean()) if abs(inside.mean()) < noise else 0.0
    return bool(np.ptp(np.cumsum(inside - offset)) > MEANT + _WALKS * noise * np.sqrt(len(inside)))


def _uneven(steps: np.ndarray, expected: float) -> bool:
    """Whether a position moves, and not by the constant ``expected``."""
    return bool(np.std(steps) > 0.3 * np.abs(steps).mean() and _travels(steps - expected))


def _commanded(motion: Motion, m: int, run: slice) -> bool:
    """Whether command m moves in the rows of ``run`` as it does elsewhere, and enough to overcome dry friction."""
    driver, u = motion.drivers[m], motion.u[:, m]
    inside, everywhere = u[run].std(), u.std()
    if driver.position:
        coordinate = motion.coordinates[driver.coordinate]
        meant = min(MEANT, _OF_RANGE * (coordinate.high - coordinate.low))  # a gripper's finger has centimetres in all
        return bool(inside > 0.3 * everywhere and np.ptp(u[run]) * abs(driver.scale) > meant)
    return bool(inside > 0.7 * everywhere and everywhere > 0)
