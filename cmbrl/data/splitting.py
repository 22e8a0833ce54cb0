"""Which rows belong together: splits by episode, windows within an episode, logs joined end to end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.data.fields import ROWS, Fields
from cmbrl.errors import UserError
from cmbrl.numbers import real, real_array, shown, whole


def episode_mask(episode: np.ndarray, fraction: float, seed: int) -> np.ndarray:
    """Mask (N,) of the rows in a random ``fraction`` of the episodes (N,).

    Raises UserError for a fraction outside (0, 1), or a single episode.
    """
    seed = whole(seed, "seed", least=0)
    if not 0.0 < real(fraction, "fraction") < 1.0:
        raise UserError(f"fraction is {fraction}; give a share of the episodes above 0 and below 1")
    known = np.unique(episode)
    if len(known) < 2:
        raise UserError(
            f"the log has {len(known)} episode{'s' * (len(known) != 1)}, but a split needs two; record more, "
            "or test on a separate log"
        )
    count = min(max(round(fraction * len(known)), 1), len(known) - 1)
    chosen = np.random.default_rng(seed).permutation(known)[:count]
    return np.isin(episode, chosen)


def follows(log: Fields) -> np.ndarray:
    """Mask (N-1,): row i+1 continues the episode of row i from the state in which row i ended."""
    same = log["episode"][1:] == log["episode"][:-1]
    for now, after in ((log["q"], log["q_next"]), (log["v"], log["v_next"])):
        same = same & np.isclose(now[1:], after[:-1], rtol=1e-9, atol=1e-9).all(axis=1)
    return same


def row_numbers(rows: Any, count: int) -> np.ndarray:
    """Row numbers from a slice, a mask (count,) or whole numbers (which may count from the end).

    Raises UserError for anything else, and for a row that is not there.
    """
    if isinstance(rows, slice):
        try:
            return np.arange(count)[rows]
        except (TypeError, ValueError):
            raise UserError(f"rows = {shown(rows)}: give whole numbers in the slice") from None
    array = real_array(rows, "rows")
    if np.asarray(rows).dtype.kind == "b" and array.shape == (count,):
        return np.flatnonzero(array)
    if array.ndim != 1 or (array != np.floor(array)).any() or not ((array >= -count) & (array < count)).all():
        raise UserError(
            f"rows has shape {array.shape}; give a mask ({count},), or numbers of rows from 0 to {count - 1}"
        )
    return array.astype(np.int64)


def window_starts(log: Fields, k: int) -> np.ndarray:
    """Rows that start k consecutive transitions: int64, ascending, overlapping; empty if no episode is that long."""
    rows = len(log["q"])
    if rows < k:
        return np.empty(0, dtype=np.int64)
    breaks = np.concatenate([[0], np.cumsum(~follows(log))])  # number of breaks before a row
    return np.flatnonzero(breaks[k - 1 :] == breaks[: rows - k + 1]).astype(np.int64)


def joined(logs: Sequence[Fields]) -> Fields:
    """The rows of all ``logs`` in order, with their episodes renumbered so that no two coincide.

    Raises UserError for no logs, and for logs of different shapes or time steps.
    """
    if not logs:
        raise UserError("no logs to join; give at least one")
    first = logs[0]
    for k, log in enumerate(logs):
        if _kind(log) != _kind(first):
            raise UserError(f"log {k} has another robot or time step than log 0; join logs of one robot only")
    episodes, unused = [], 0
    for log in logs:
        episode = log["episode"] + unused - log["episode"].min(initial=0)  # numbers below zero would collide
        unused = episode.max(initial=unused - 1) + 1
        episodes.append(episode)
    rows: Fields = {name: np.concatenate([log[name] for log in logs]) for name in ROWS}  # type: ignore[literal-required, assignment]
    one = np.zeros(len(rows["q"]), dtype=np.int64)
    return {**first, **rows, "episode": np.concatenate(episodes), "recording": one}


def _kind(log: Fields) -> tuple[float, ...]:
    return log["q"].shape[1], log["v"].shape[1], log["u"].shape[1], log["dt"]
