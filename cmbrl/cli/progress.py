"""Progress on stderr: bars on a terminal; lines of what has a known end where a file or a pipe takes them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from threading import Event, Lock, RLock, Thread
from time import monotonic

from tqdm import tqdm

tqdm.set_lock(RLock())  # tqdm's own lock is a semaphore of the system, which a worker that is ended leaves behind
FIRST, OFTEN, MOST = 2.0, 5.0, 60.0  # s before the first line; between lines, at least and at most
_RARER = 0.2  # of the time that has passed, between lines


@contextmanager
def counting(what: str, total: int, unit: str = "step") -> Iterator[Callable[[int], object]]:
    """Yields a function to call with the number of units done since its last call."""
    with tqdm(desc=what, total=total, unit=unit, disable=None, leave=False, dynamic_ncols=True) as bar:
        yield bar.update


@contextmanager
def fraction(what: str) -> Iterator[Callable[[float, str], None]]:
    """Yields a function to call with the share of the work done, 0 to 1, and a short text."""
    if not sys.stderr.isatty():
        lines, ended = Lines(what), Event()
        teller = Thread(target=lines.keep_telling, args=(ended,), daemon=True)
        teller.start()
        try:
            yield lines.show
        finally:
            ended.set()
            teller.join()
        return
    shape = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
    with tqdm(desc=what, total=1.0, leave=False, dynamic_ncols=True, bar_format=shape) as bar:

        def show(done: float, text: str) -> None:
            bar.set_postfix_str(text, refresh=done <= bar.n)  # what comes may take long
            bar.update(max(0.0, done - bar.n))

        yield show


class Lines:
    """Lines on stderr of what ``what`` is at: what runs after ``FIRST`` seconds, then what is new, ever more rarely.

    What goes on is told again every ``MOST`` seconds. What comes at the end, after a line before, is told at once.
    """

    def __init__(self, what: str) -> None:
        self._what, self._begun, self._told = what, monotonic(), -inf
        self._latest: tuple[float, str] | None = None
        self._shown = ""
        self._lock = Lock()

    def show(self, done: float, text: str) -> None:
        """Takes the share of the work that is done, and what is being done."""
        self._latest = done, text
        self.tell()

    def tell(self) -> None:
        """Writes a line if it is due."""
        with self._lock:
            if self._latest is None:
                return
            (done, text), now = self._latest, monotonic() - self._begun
            often = min(max(OFTEN, _RARER * now), MOST) if text != self._shown else MOST
            due = max(FIRST, self._told + often)
            ends = done >= 1.0 and self._shown not in ("", text)
            if now >= due or ends:
                self._told, self._shown = now, text
                print(f"{self._what}: {done:.0%}, {now:.0f} s, {text}", file=sys.stderr, flush=True)

    def keep_telling(self, ended: Event) -> None:
        """Tells of what began before its line was due, until ``ended``."""
        while not ended.wait(1.0):
            self.tell()
