"""One progress bar: on a terminal it shows on stderr, everywhere else it is silent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


@contextmanager
def bar(what: str, total: int | None = None, unit: str = "step") -> Iterator[Callable[[int], object]]:
    """Gives a function to call with the number of units done since its last call."""
    with tqdm(desc=what, total=total, unit=unit, disable=None, leave=False, dynamic_ncols=True) as shown:
        yield shown.update
