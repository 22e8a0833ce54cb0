"""Progress bars on stderr, shown only on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import RLock

from tqdm import tqdm

tqdm.set_lock(RLock())  # tqdm's own lock is a semaphore of the system, which a worker that is ended leaves behind


@contextmanager
def counting(what: str, total: int, unit: str = "step") -> Iterator[Callable[[int], object]]:
    """Yields a function to call with the number of units done since its last call."""
    with tqdm(desc=what, total=total, unit=unit, disable=None, leave=False, dynamic_ncols=True) as bar:
        yield bar.update


@contextmanager
def fraction(what: str) -> Iterator[Callable[[float, str], None]]:
    """Yields a function to call with the share of the work done, 0 to 1, and a short text."""
    shape = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
    with tqdm(desc=what, total=1.0, disable=None, leave=False, dynamic_ncols=True, bar_format=shape) as bar:

        def show(done: float, text: str) -> None:
            bar.set_postfix_str(text, refresh=done <= bar.n)  # what comes may take long
            bar.update(max(0.0, done - bar.n))

        yield show
