"""Velocities that are later than their positions: a driver has filtered them, or they are differences of positions.

A filter of first order gives v + lag dv/dt = dq/dt, and what comes late by less than motion changes in is the same to
first order. Over a span from a to b that is

    q(b) - q(a) - (integral of v) = lag (v(b) - v(a)),

a regression of what positions move more than velocities tell on what velocities change by. Noise of velocities, white
or not, leaves the slope, or makes it smaller.

Differences of neighbouring positions are those of the middle between them, so half a row late. Steps of the model are
semi-implicit: where one of them makes a row, that is what they go by.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Motion
from cmbrl.data.plausible.still import MEANT

_SPAN = 0.1  # [s] of motion over which a lag shows
_SAMPLES, _LEAST = 1.5, 4e-3  # time steps, s: what is late by less is as noise
_ALIKE, _OFTEN = 1e-4, 0.9  # of how far positions move in a row: rounding of differences; share of the rows
_EXPLAINED = 0.5  # of what positions and velocities disagree by
_ROWS, _MOST = 200, 20000  # that tell a lag; that are looked at
_SHARE = 0.5  # of the joints that move

Part = tuple[np.ndarray, np.ndarray]  #: positions (T,) and velocities (T,) without a gap


def lag(parts: Iterable[Part], dt: float, step: float) -> float | None:
    """By how much [s] velocities are later than positions; 0 where they are not, None where that does not show.

    ``dt``: from row to row; ``step``: of the model [s].
    """
    span = max(2, round(_SPAN / dt))
    more, change, moves, apart, moved = [], [], 0.0, [], []
    for q, v in parts:
        moved.append(np.diff(q))
        apart.append(np.abs(moved[-1] - dt * v[1:]))
        if len(q) <= span:
            continue
        travelled = np.concatenate([[0.0], np.cumsum(0.5 * dt * (v[1:] + v[:-1]))])
        more.append((q[span:] - q[:-span] - (travelled[span:] - travelled[:-span]))[:_MOST])
        change.append((v[span:] - v[:-span])[:_MOST])
        moves = max(moves, float(np.ptp(q)))
    y, x = (np.concatenate(column) if column else np.zeros(0) for column in (more, change))
    square = float(x @ x)
    if len(y) < _ROWS or moves < MEANT or square == 0.0:
        return None
    if np.quantile(np.concatenate(apart), _OFTEN) <= _ALIKE * np.concatenate(moved).std():
        return 0.5 * (dt - step) if dt > 1.5 * step else 0.0
    y, x = y - y.mean(), x - x.mean()
    slope = float(x @ y) / max(float(x @ x), 1e-300)
    rest = y - slope * x
    late = slope > max(_SAMPLES * dt, _LEAST) and float(rest @ rest) < _EXPLAINED * float(y @ y)
    return slope if late else 0.0


def told(lags: Sequence[tuple[str, float | None]]) -> str:
    """Which joints' velocities lag, and by how much, in words; empty where most that move do not."""
    known = [(name, late) for name, late in lags if late is not None]
    late = [(name, by) for name, by in known if by > 0.0]
    if not late or len(late) < _SHARE * len(known):
        return ""
    more = f" and {len(late) - 1} more" if len(late) > 1 else ""
    return f"{late[0][0]}{more} lag their positions by {1e3 * float(np.median([by for _, by in late])):.2g} ms"


def late(motion: Motion) -> Iterator[Finding]:
    """A warning of transitions most of whose velocities lag: a fit takes them for those of the same moment."""
    if motion.v_now is None:
        return
    v = motion.v_now
    lags = []
    for k, coordinate in enumerate(motion.coordinates):
        q = np.cumsum(np.concatenate([[0.0], motion.change[:-1, k]]))  # without whole turns; wrong across gaps only
        parts = [(q[block], v[block, k]) for block in motion.blocks]
        lags.append((repr(coordinate.name), lag(parts, motion.dt, motion.step)))
    if text := told(lags):
        yield Finding(
            f"v of joints {text}, as a driver's filter or differences of positions do, and a fit takes both for those "
            "of one moment (and finds commands late): give `cmbrl import` --as positions",
            sure=False,
        )
