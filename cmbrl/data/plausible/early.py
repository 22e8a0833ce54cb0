"""Joints that move before their commands do: the two were stamped by different clocks, or recorded apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.answers import ROWS
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import LAG, MOST, Motion
from cmbrl.data.plausible.still import MEANT

_LEAD = 0.1  # [s] further ahead the next beat of a rhythm may be
_LAGS = 50  # lags to each side
_LEAST = 2  # samples: a log may say the command that acts next, or acted last
_BETTER = 0.5  # of what is left by any delay
_WELL = 0.1  # of the motion is left: a slow servo is not told by a shift
_MOST = 0.5  # of the joints that move


def early(motion: Motion) -> Iterator[Finding]:
    """Episodes in which most joints follow their targets before these are there: no servo does."""
    servos = [m for m, driver in enumerate(motion.drivers) if driver.position]
    found = []
    for block in motion.blocks:
        leads = [lead for m in servos if (lead := _lead(motion, m, block)) is not None]
        if leads and np.mean(np.array(leads) > 0) > _MOST:
            found.append((float(np.median([lead for lead in leads if lead > 0])), block))
    if found:
        lead, block = max(found, key=lambda one: one[0])
        where = f"rows {block.start} to {block.stop - 1}"
        among = f"; {len(found)} of {len(motion.blocks)} episodes are so" if len(motion.blocks) > 1 else ""
        yield Finding(
            f"joints move {1e3 * lead:.0f} ms before their targets do ({motion.command}, {where}{among}), as no servo: "
            "targets stamped late, or by another clock? Tell `cmbrl import` by --command-offset",
            sure=False,
        )


def _lead(motion: Motion, m: int, block: slice) -> float | None:
    """By how much [s] a joint is ahead of its target; 0 if it is not, None where the target hardly moves."""
    some = slice(block.start, min(block.stop, block.start + MOST))
    place = motion.now[some, motion.drivers[m].coordinate]
    target = motion.u[some, m] * motion.drivers[m].scale
    most = int(min(LAG / motion.dt, len(place) // 4))
    if len(place) < ROWS or np.ptp(target) < MEANT or not most:
        return None
    ahead = np.unique(np.linspace(1, min(_LEAD / motion.dt, most), _LAGS).astype(int))
    behind = np.unique(np.linspace(0, most, _LAGS).astype(int))

    def left(shift: int) -> float:
        rows = np.arange(most, len(place) - most)
        return float(np.std(place[rows] - target[rows + shift]))

    misfits = [left(k) for k in ahead.tolist()]
    best = int(np.argmin(misfits))
    well = misfits[best] < min(_BETTER * min(left(-k) for k in behind.tolist()), _WELL * float(np.std(place)))
    return float(ahead[best] * motion.dt) if well and ahead[best] >= _LEAST else 0.0
