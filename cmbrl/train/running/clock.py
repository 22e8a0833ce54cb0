"""The time that a run has taken in all its parts: of the wall clock, and of processors."""

from __future__ import annotations

import time
from dataclasses import dataclass, field


@dataclass
class RunClock:
    """Goes on from what earlier parts of a run took.

    Processor time, of all threads, is what to compare where other programs share the machine.
    """

    seconds: float = 0.0  #: of the wall clock, when last read
    processor_seconds: float = 0.0  #: of this process, when last read
    _begun: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.go_on()

    def go_on(self) -> None:
        """What passes from now on counts; what has passed since the last reading does not."""
        self._begun = time.monotonic() - self.seconds, time.process_time() - self.processor_seconds

    def read(self) -> dict[str, float]:
        """Both by name [s]."""
        wall, processor = self._begun
        self.seconds, self.processor_seconds = time.monotonic() - wall, time.process_time() - processor
        return self.told()

    def told(self) -> dict[str, float]:
        """Both as last read [s]."""
        return {"seconds": self.seconds, "processor_seconds": self.processor_seconds}
