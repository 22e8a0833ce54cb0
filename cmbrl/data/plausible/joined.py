"""Logs that go on with another robot, or another recording."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import LAG, Motion
from cmbrl.data.plausible.still import LONG, MEANT, loud

APART = 0.15  #: [rad, m] dry friction moves where servos stand by less when they turn round
JUMP = 5  #: times the 99th percentile of a step, and of the steps before and after


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
    """Two joints or more, with their commands, that stand still from one row to the end, or up to one row.

    Their encoders lose the noise that they have elsewhere: those with coarse counts are quiet wherever a robot rests.
    """
    starts: dict[tuple[str, int], list[int]] = {}
    for driver_number, driver in enumerate(motion.drivers):
        both = np.column_stack([motion.now[:, driver.coordinate], motion.u[:, driver_number]])
        moves = np.flatnonzero((np.diff(both, axis=0) != 0).any(axis=1))
        if len(moves) < LONG:
            continue
        first, last = int(moves[0]), int(moves[-1]) + 1
        for name, row, share in (("end", last, len(both) - last), ("start", first, first)):
            run = slice(last, len(both)) if name == "end" else slice(0, first + 1)
            if share > 0.2 * len(both) and share >= LONG and loud(both[:, 0], motion.blocks, run):
                starts.setdefault((name, row), []).append(driver.coordinate)
    for (name, row), joints in starts.items():
        if 2 <= len(joints) < len(motion.drivers):
            others = f"{motion.position_of(joints[0])} and {len(joints) - 1} more, with their commands,"
            told = f"stand still after row {row}" if name == "end" else f"stand still up to row {row}"
            yield Finding(f"{others} {told}: does another robot, with fewer joints, share the file?")


def unexplained(motion: Motion, servos: list[int], places: list[int]) -> np.ndarray:
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
    rest = unexplained(motion, servos, places)
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
