"""Intervals of statistics over a few independent draws or seeds, by the percentile bootstrap."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

RESAMPLES = 10_000


def interval(statistic: Callable[[np.ndarray], Any], count: int, seed: int = 0) -> tuple[float, float]:
    """95 % interval of a statistic of draws, by resampling draws: ``statistic`` of row numbers (resamples, count)."""
    rows = np.random.default_rng(seed).integers(count, size=(RESAMPLES, count))
    low, high = np.nanquantile(statistic(rows), (0.025, 0.975))
    return float(low), float(high)
