"""Times under varying load: the pieces of work to be compared take turns, and ratios are taken within a turn."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Work = dict[Any, tuple[Callable[[], object], int]]  #: name -> (function, units of work in one call, at least 1)


@dataclass(frozen=True)
class Spread:
    """Median, lowest and highest of the repeats."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: np.ndarray) -> Spread:
        """Of repeats (n,)."""
        return cls(float(np.median(values)), float(np.min(values)), float(np.max(values)))


def interleaved(
    work: Mapping[Any, tuple[Callable[[], object], int]], repeats: int, clock: Callable[[], float] = time.thread_time
) -> dict[Any, np.ndarray]:
    """Seconds per unit (repeats,) of every piece of ``work``, A B C A B C ..., after one turn that does not count.

    Args:
        work: see :data:`Work`.
        repeats: turns that count, at least 1.
        clock: ``time.thread_time`` counts the processor time of the calling thread, so that other processes do not
            count; ``time.perf_counter`` is for work on several threads.
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
    finally:
        if collects:
            gc.enable()
    return seconds
