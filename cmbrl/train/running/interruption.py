"""Ctrl-C in the middle of a long run: what is under way finishes first."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Gives a function that tells whether Ctrl-C was pressed; a second Ctrl-C interrupts at once.

    The current update finishes first, so that no checkpoint holds a half-updated trainer.
    """
    asked = False

    def ask(*_: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        print(
            "\ncmbrl: stopping after this iteration (Ctrl-C again: at once, from the last checkpoint)", file=sys.stderr
        )

    try:
        previous = signal.signal(signal.SIGINT, ask)
    except ValueError:  # not in the main thread, where Ctrl-C arrives
        yield lambda: False
        return
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, previous)
