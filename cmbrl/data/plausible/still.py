"""Sensors that stand still while what they measure moves, and logs that go on with another robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import LAG, Motion
from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

LONG = 50  #: samples; and RARE times as long as others, so that coarse encoders are no fault
RARE = 10
MEANT = 0.05  #: [rad, m] a target has to move by so much, more than dry friction holds
_OF_RANGE = 0.2  # between the stops, the same
_ON_GRID, _ONWARDS, _ROUNDING = 0.02, 3.0, 1e-9  # of an encoder's count; counts; [rad, m]
_STRETCHES, _ALTERNATES = 8, -0.5  # of LONG samples, to tell noise by; correlation of third differences
_REPEATS = 0.05  # share of samples that are the one before, of an encoder with counts that was read in between
_AS_FAST = 0.3  # of the usual speed elsewhere
_WALKS = 4.0  # times the root of the samples: what white noise of a velocity adds up to
APART = 0.15  #: [rad, m] dry friction moves where servos stand by less when they turn round
JUMP = 5  #: times the 99th percentile of a step, and of the steps before and after


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
            command, sure = motion.command_of(driven[k]), not _sticks(motion.now[:, k], run)
            cause = "a stuck sensor?" if sure else "a joint that sticks, or a stuck sensor?"
            yield Finding(f"{motion.position_of(k)} is constant {where} while {command} moves: {cause}", sure=sure)
        elif (k not in driven or np.ptp(motion.u[run, driven[k]]) > 0) and _loud(motion.now[:, k], motion.blocks, run):
            # without a command that goes on: see ``joined``
            yield Finding(
                f"{motion.position_of(k)} is constant {where}, without the noise that it has elsewhere: a stuck sensor?"
            )
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
    moved = np.abs(steps[np.abs(steps) > _ROUNDING])
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
    return bool(abs(counts[run.stop - 1]) <= max(_ONWARDS, usual))


def _loud(x: np.ndarray, blocks: Iterable[slice], run: slice) -> bool:
    """Whether the sensor of ``x`` (R,) shows noise outside of ``run``, of which no joint's rest is free.

    Third differences of noise alternate, with a correlation of -3/4; those of smooth motion go on. The calmest
    stretches tell it, where motion hides it least. Encoders with counts are quiet at rest; where samples were read in
    between, they lie on no grid, and repeat all the same.
    """
    again = np.abs(np.diff(np.delete(x, run))) < _ROUNDING
    if _coarse(x) is not None or (len(again) and again.mean() > _REPEATS):
        return False
    calm = []
    for block in blocks:
        for start in range(block.start, block.stop - LONG + 1, LONG):
            if start >= run.stop or start + LONG <= run.start:
                third = np.diff(x[start : start + LONG], n=3)
                calm.append((float(third @ third), float(third[1:] @ third[:-1])))
    square, product = np.sum(sorted(calm)[: max(len(calm) // 4, 1)], axis=0) if calm else (0.0, 0.0)
    return bool(len(calm) >= _STRETCHES and square > 0.0 and product < _ALTERNATES * square)


def turned(q: np.ndarray, blocks: Iterable[slice], scene: Scene) -> Iterator[Finding]:
    """Quaternions of q (R, nq) that repeat for long, without the noise that they have elsewhere."""
    blocks = list(blocks)
    for joint in scene.joints:
        if joint.kind != JointKind.BALL or not len(q):
            continue
        turn = q[:, joint.qadr : joint.qadr + 4]
        run = _longest(_runs(np.cumsum(np.r_[False, (np.diff(turn, axis=0) != 0).any(axis=1)])))
        if run is not None and any(_loud(x, blocks, run) for x in turn.T[1:]):
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
    noise = _white(inside)
    offset = float(inside.mean()) if abs(inside.mean()) < noise else 0.0
    return bool(np.ptp(np.cumsum(inside - offset)) > MEANT + _WALKS * noise * np.sqrt(len(inside)))


def _white(x: np.ndarray) -> float:
    """The standard deviation of white noise that third differences of ``x`` (R,) show."""
    third = np.abs(np.diff(x, n=3))
    return float(1.4826 * np.median(third) / np.sqrt(20.0)) if len(third) else 0.0


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


def joined(motion: Motion) -> Iterator[Finding]:
    """Rows where another recording begins: many joints jump at once, or joints stop to be there."""
    if len(motion.now) < LONG or not motion.coordinates:
        return
    step = np.abs(motion.change)
    usual = np.percentile(step, 99, axis=0)
    beside = np.maximum(np.vstack([step[1:], step[-1:]]), np.vstack([step[:1], step[:-1]]))
    jumps = (step > JUMP * usual + MEANT) & (step > JUMP * beside)
    many = np.flatnonzero(jumps.sum(axis=1) >= max(2, (len(motion.coordinates) + 1) // 2))
    if 0 < len(many) < 5:
        k = int(np.flatnonzero(jumps[many[0]])[0])
        yield Finding(
            f"{motion.position_of(k)} and {int(jumps[many[0]].sum()) - 1} more jump after row {many[0]} (by "
            f"{motion.change[many[0], k]:.3g} in one step): two recordings in one file? Number them as episodes"
        )
    yield from _vanished(motion)


def _vanished(motion: Motion) -> Iterator[Finding]:
    """Two joints or more, with their commands, that stand still from one row to the end, or up to one row."""
    starts: dict[tuple[str, int], list[int]] = {}
    for driver_number, driver in enumerate(motion.drivers):
        both = np.column_stack([motion.now[:, driver.coordinate], motion.u[:, driver_number]])
        moves = np.flatnonzero((np.diff(both, axis=0) != 0).any(axis=1))
        if len(moves) < LONG:
            continue
        first, last = int(moves[0]), int(moves[-1]) + 1
        for name, row, share in (("end", last, len(both) - last), ("start", first, first)):
            if share > 0.2 * len(both) and share >= LONG:
                starts.setdefault((name, row), []).append(driver.coordinate)
    for (name, row), joints in starts.items():
        if 2 <= len(joints) < len(motion.drivers):
            others = f"{motion.position_of(joints[0])} and {len(joints) - 1} more, with their commands,"
            told = f"stand still after row {row}" if name == "end" else f"stand still up to row {row}"
            yield Finding(f"{others} {told}: does another robot, with fewer joints, share the file?")


def _unexplained(motion: Motion, servos: list[int], places: list[int]) -> np.ndarray:
    """Positions without what is linear in their own targets, now and some time ago."""
    lags = np.unique(np.linspace(0, LAG / motion.dt, 8).round().astype(int))
    rows = np.arange(int(lags[-1]), len(motion.now))
    rest = []
    for m, k in zip(servos, places, strict=True):
        basis = np.column_stack([np.ones(len(rows)), *(motion.u[rows - lag, m] for lag in lags)])
        y = motion.now[rows, k]
        rest.append(y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0])
    return np.column_stack(rest)


def offsets(motion: Motion) -> Iterator[Finding]:
    """A warning where positions follow their targets with another offset from some row on, in most joints at once."""
    servos = [m for m, driver in enumerate(motion.drivers) if driver.position]
    rows = len(motion.now)
    if len(servos) < 2 or rows < 4 * LONG or len(motion.blocks) > 1:
        return
    places = [motion.drivers[m].coordinate for m in servos]
    rest = _unexplained(motion, servos, places)
    rows = len(rest)
    counts = np.arange(1, rows)[:, None]
    sums = np.cumsum(rest, axis=0)[:-1]
    before, after = sums / counts, (rest.sum(axis=0) - sums) / (rows - counts)
    gain = (after - before) ** 2 * counts * (rows - counts) / rows
    inside = slice(LONG, rows - LONG)
    at = gain[inside].argmax(axis=0) + LONG
    row = int(np.median(at))
    left, right = rest[:row], rest[row:]
    shift = np.abs(np.median(right, axis=0) - np.median(left, axis=0))
    spread = 1.4826 * np.maximum(*(np.median(np.abs(x - np.median(x, axis=0)), axis=0) for x in (left, right)))
    u = motion.u[-rows:, servos]
    commanded = (u[:row].std(axis=0) > 0) & (u[row:].std(axis=0) > 0)
    drift = np.vander(np.arange(rows) / rows, 3)
    slow = ((rest - drift @ np.linalg.lstsq(drift, rest, rcond=None)[0]) ** 2).sum(axis=0)
    jumped = sum(((part - part.mean(axis=0)) ** 2).sum(axis=0) for part in (left, right)) < 0.5 * slow
    clear = commanded & jumped & (shift > 3 * spread) & (shift > APART) & (np.abs(at - row) < 0.03 * rows)
    if clear.mean() > 0.5 and clear.sum() >= 2:
        k = places[int(np.flatnonzero(clear)[0])]
        yield Finding(
            f"{motion.position_of(k)} and {int(clear.sum()) - 1} more follow their targets with another offset from "
            f"row {row + motion.blocks[0].stop - len(rest)} on: two robots, or two loads, in one file?",
            sure=False,
        )
