"""Stretches of rows: those of a mask, and those between breaks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def stretches(mask: np.ndarray) -> list[tuple[int, int]]:
    """First rows, and ends, of the runs of True in ``mask`` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def between(breaks: np.ndarray) -> tuple[slice, ...]:
    """Stretches of T rows between the ``breaks`` (T - 1,), a mask of rows that the next one does not continue."""
    edges = np.concatenate([[0], np.flatnonzero(breaks) + 1, [len(breaks) + 1]]).tolist()
    return tuple(slice(a, b) for a, b in pairwise(edges))
