"""Progress on stderr: bars on a terminal; a line a minute of what has a known end where a file or a pipe takes them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import RLock
from time import monotonic

from tqdm import tqdm

tqdm.set_lock(RLock())  # tqdm's own lock is a semaphore of the system, which a worker that is ended leaves behind
EVERY = 60.0  # s between lines


@contextmanager
def counting(what: str, total: int, unit: str = "step") -> Iterator[Callable[[int], object]]:
    """Yields a function to call with the number of units done since its last call."""
    with tqdm(desc=what, total=total, unit=unit, disable=None, leave=False, dynamic_ncols=True) as bar:
        yield bar.update


@contextmanager
def fraction(what: str) -> Iterator[Callable[[float, str], None]]:
    """Yields a function to call with the share of the work done, 0 to 1, and a short text."""
    if not sys.stderr.isatty():
        yield _lines(what)
        return
    shape = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
    with tqdm(desc=what, total=1.0, leave=False, dynamic_ncols=True, bar_format=shape) as bar:

        def show(done: float, text: str) -> None:
            bar.set_postfix_str(text, refresh=done <= bar.n)  # what comes may take long
            bar.update(max(0.0, done - bar.n))

        yield show


def _lines(what: str) -> Callable[[float, str], None]:
    """Writes what it is called with, but none of the first ``EVERY`` seconds and one line in as many.

    What comes at the end, after a line before, is written at once: nothing more may be said for minutes.
    """
    begun = told = monotonic()

    def show(done: float, text: str) -> None:
        nonlocal told
        now = monotonic()
        if now - told >= EVERY or (done >= 1.0 and told > begun):
            told = now
            print(f"{what}: {done:.0%}, {now - begun:.0f} s, {text}", file=sys.stderr, flush=True)

    return show
