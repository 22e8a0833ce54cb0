"""The time that a fit has used: by the clock on the wall, and as on a machine that does nothing else."""

from __future__ import annotations

import time
from dataclasses import dataclass

_MOST_STRETCH = 5.0  # what is read from a slow disk, say, says nothing of the processor


@dataclass(frozen=True)
class Clock:
    """When a fit began: ``wall`` on the monotonic clock, ``processor`` of this process [s]."""

    wall: float
    processor: float

    @classmethod
    def now(cls) -> Clock:
        """One that begins now."""
        return cls(time.monotonic(), time.process_time())

    @property
    def elapsed(self) -> float:
        """Seconds since then."""
        return time.monotonic() - self.wall

    @property
    def busy(self) -> float:
        """The same without what other processes took: of one thread, its processor time; of many, what passed."""
        return min(self.elapsed, time.process_time() - self.processor)

    @property
    def stretch(self) -> float:
        """How many seconds have passed for each busy one: more than 1 where other processes take their share."""
        return min(max(self.elapsed / max(self.busy, 1e-3), 1.0), _MOST_STRETCH)
