"""One joint whose position jumps in one sample, as no motor and no blow moves it: a slip of its encoder, or lost rows.

A blow changes how fast a joint goes, a slip where it is: its row differs from those before and after, the same way.
Then a servo follows its target with another offset, or the target jumps with the position, or a velocity contradicts.
A position that has neither target nor velocity is warned of.
A joint that a step of its target moves within one sample has that target before; it does not jump with it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.joined import unexplained
from cmbrl.data.plausible.motion import Motion
from cmbrl.data.plausible.still import LONG, MEANT, ONWARDS, ROUNDING

_OFTEN = 5.0  # times the 99th percentile of such differences
_ROWS = 3  # at most: play and coarse counts jump again and again
_SLIDES = 0.2  # of what is meant by a hinge
_ALIKE, _STEADY = 0.3, 0.2  # of the jump: what an offset may differ from it by; by which it may vary
_WHILE = 0.3  # [s] before and after, that tell the offset
_BACK = 4  # samples, within which a lost reading is over (``alone``)


def slipped(motion: Motion) -> Iterator[Finding]:
    """Jumps of single joints, as far as targets or velocities tell what they are."""
    if len(motion.now) < 2 * LONG:
        return
    driven = {driver.coordinate: m for m, driver in enumerate(motion.drivers) if driver.position}
    likely = []
    for k, coordinate in enumerate(motion.coordinates):
        jumps = _jumps(motion, k, MEANT if coordinate.hinge else _SLIDES * MEANT)
        for row in jumps if len(jumps) <= _ROWS else ():
            if found := _told(motion, k, driven.get(k), row):
                if found.sure:
                    yield found
                else:
                    likely.append(found)
                break
    if likely:  # of rows that are lost, all joints tell the same
        more = f" (and {len(likely) - 1} more)" if len(likely) > 1 else ""
        yield Finding(f"{likely[0].text}{more}", sure=False)


def _jumps(motion: Motion, k: int, meant: float) -> list[int]:
    """Rows that move coordinate ``k`` by ``meant`` or more, as neither those before nor those after do."""
    inside = [np.arange(one.start + 1, one.stop - 1) for one in motion.blocks if one.stop - one.start > LONG]
    if not inside:
        return []
    rows = np.concatenate(inside)
    step = motion.change[:, k]
    before, after = step[rows] - step[rows - 1], step[rows] - step[rows + 1]
    apart = np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    count = np.abs(step[np.abs(step) > ROUNDING]).min(initial=np.inf)  # of a coarse encoder, which moves on by it
    found = rows[apart > max(meant + _OFTEN * np.percentile(apart, 99), ONWARDS * count)]
    back = [row for row in found if np.any((np.abs(found - row) <= _BACK) & (step[found] * step[row] < 0))]
    return [int(row) for row in found if row not in back]


def _told(motion: Motion, k: int, m: int | None, row: int) -> Finding | None:
    """What the jump of coordinate ``k`` in ``row`` is, by its target ``m`` or its velocity; None if neither tells."""
    jump = float(motion.change[row, k])
    what = f"{motion.position_of(k)} jumps by {jump:.3g} in one sample, after row {row},"
    if motion.v_now is not None and motion.v_after is not None:
        told = motion.dt * float(motion.v_now[row, k] + motion.v_after[row, k]) / 2
        if abs(told) < _STEADY * abs(jump):
            return Finding(
                f"{what} where its velocity tells {told:.2g}: did its encoder slip, or were rows lost? Give the rows "
                "before and after as two episodes, or take the jump out of the column"
            )
        return None
    if m is None:
        remedy = "Give the rows before and after as two episodes, or take the jump out of the column"
        return Finding(f"{what} as in no other: did its encoder slip, or were rows lost? {remedy}", sure=False)
    target, scaled = motion.command_of(m), motion.drivers[m].scale * motion.u[:, m]
    moved = abs(scaled[row + 1] - scaled[row])
    if moved > max(_ALIKE * abs(jump), _OFTEN * np.percentile(np.abs(np.diff(scaled)), 99)):  # with it, not before it
        return Finding(f"{what} together with {target}: were rows lost, or is it another recording?", sure=False)
    shift, spread = _shift(motion, k, m, row)
    if spread < _STEADY * abs(jump) and abs(shift - jump) < _ALIKE * abs(jump):
        return Finding(
            f"{what} and then follows {target} with an offset that is as much larger: did its encoder slip, or begin "
            "anew from another zero? Fit the rows before or after alone, or take the jump out of the column"
        )
    return None


def _shift(motion: Motion, k: int, m: int, row: int) -> tuple[float, float]:
    """By how much coordinate ``k`` is farther from its target ``m`` after ``row`` than before, and how that varies."""
    block = next(one for one in motion.blocks if one.start <= row < one.stop)
    count = max(LONG, round(_WHILE / motion.dt))
    before = slice(max(block.start, row + 1 - count), row + 1)
    after = slice(row + 1, min(block.stop, row + 1 + count, len(motion.now)))
    off = unexplained(motion, [m], [k])[:, 0]
    off = np.concatenate([np.full(len(motion.now) - len(off), np.nan), off])  # the first have no past
    parts = [x[np.isfinite(x)] for x in (off[before], off[after])]
    if min(map(len, parts)) < LONG:
        return 0.0, np.inf
    spread = max(float(1.4826 * np.median(np.abs(part - np.median(part)))) for part in parts)
    return float(np.median(parts[1]) - np.median(parts[0])), spread
