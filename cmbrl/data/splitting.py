"""Which rows go together: splits that never cut an episode, windows that never cross one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions


def episode_mask(episode: np.ndarray, fraction: float, seed: int) -> np.ndarray:
    """Mask (N,) of the rows whose episode is among the ``fraction`` drawn without replacement under ``seed``.

    Raises UserError when a split would leave one side empty whatever is drawn.
    """
    if not 0.0 < fraction < 1.0:
        raise UserError(f"fraction is {fraction}: a share between 0 and 1 (both excluded) of the episodes is needed")
    known = np.unique(episode)
    if len(known) < 2:
        raise UserError(
            f"the log has {len(known)} episode, a split by episode needs at least two: record more, "
            "or give a log of its own for testing"
        )
    count = min(max(round(fraction * len(known)), 1), len(known) - 1)
    chosen = np.random.default_rng(seed).permutation(known)[:count]
    return np.isin(episode, chosen)


def follows(data: Transitions) -> np.ndarray:
    """Mask (N-1,): row i+1 is of the same episode as row i and begins in the state in which row i ended."""
    same = data.episode[1:] == data.episode[:-1]
    for now, after in ((data.q, data.q_next), (data.v, data.v_next)):
        same = same & np.isclose(now[1:], after[:-1], rtol=1e-9, atol=1e-9).all(axis=1)
    return same


def window_starts(data: Transitions, k: int) -> np.ndarray:
    """Rows that start k consecutive transitions (int64, ascending, overlapping); empty when no episode is that long."""
    if k < 1:
        raise UserError(f"a window of {k} transitions: give 1 or more")
    if len(data) < k:
        return np.empty(0, dtype=np.int64)
    breaks = np.concatenate([[0], np.cumsum(~follows(data))])  # how many breaks lie before a row
    return np.flatnonzero(breaks[k - 1 :] == breaks[: len(data) - k + 1]).astype(np.int64)


def joined(logs: Sequence[Transitions]) -> Transitions:
    """The rows of all ``logs`` in order, their episodes numbered on.

    Raises UserError on none, and on logs of different shapes or time steps.
    """
    if not logs:
        raise UserError("no logs to join: give at least one")
    first = logs[0]
    for k, log in enumerate(logs):
        if (log.q.shape[1], log.v.shape[1], log.u.shape[1], log.dt) != (*_widths(first), first.dt):
            raise UserError(f"log {k} is of another robot or time step than log 0: join logs of one robot only")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(log, name) for log in logs]) for name in _ARRAYS}
    offsets = np.cumsum([0, *(log.episode.max() + 1 for log in logs[:-1])])
    episode = np.concatenate([log.episode + offset for log, offset in zip(logs, offsets, strict=True)])
    return replace(first, **arrays, episode=episode)


_ARRAYS = ("q", "v", "u", "q_next", "v_next")


def _widths(log: Transitions) -> tuple[int, ...]:
    return log.q.shape[1], log.v.shape[1], log.u.shape[1]
