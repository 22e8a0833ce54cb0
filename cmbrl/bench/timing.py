"""Timing on a machine that is never quiet: what is to be compared takes turns, and ratios are taken within a turn."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Clock = Callable[[], float]


@dataclass(frozen=True)
class Spread:
    """Median, smallest and largest of the repeats."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: np.ndarray) -> Spread:
        """Of a row of repeats (repeats,)."""
        return cls(float(np.median(values)), float(np.min(values)), float(np.max(values)))


def interleaved(
    work: Mapping[str, tuple[Callable[[], object], int]],
    repeats: int,
    clock: Clock = time.thread_time,
    progress: Callable[[int], object] | None = None,
) -> dict[str, np.ndarray]:
    """Seconds per unit (repeats,) of every piece of work, A B C A B C ..., after one turn that does not count.

    Args:
        work: name -> (function, units of work in one call, at least 1).
        repeats: turns that count, at least 1.
        clock: ``time.thread_time`` counts the processor time of the calling thread, so that other processes do not
            count; ``time.perf_counter`` for work on several threads.
        progress: called with 1 after every turn, the first one included.
    """
    seconds = {name: np.empty(repeats) for name in work}
    collects = gc.isenabled()
    gc.disable()
    try:
        for turn in range(-1, repeats):
            for name, (function, units) in work.items():
                begin = clock()
                function()
                spent = clock() - begin
                if turn >= 0:
                    seconds[name][turn] = max(spent, 1e-12) / units
            if progress:
                progress(1)
    finally:
        if collects:
            gc.enable()
    return seconds
