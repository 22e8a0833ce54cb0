"""What follows from a log alone is computed once: of a million rows it takes a second, and fits ask hundreds of times.

A log does not change; a changed one is another object (``dataclasses.replace``), of which nothing is known yet.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions

Found = TypeVar("Found")
_KNOWN: WeakKeyDictionary[Transitions, dict[Hashable, Any]] = WeakKeyDictionary()  # forgets with the log


def remembered(log: Transitions, key: Hashable, compute: Callable[[], Found]) -> Found:
    """What ``compute()`` returns, computed at the first call with this ``log`` and ``key``.

    The key names what is computed, and all it depends on besides the log. An array that is returned is read-only.
    """
    known = _KNOWN.setdefault(log, {})
    if key not in known:
        found = compute()
        if isinstance(found, np.ndarray):
            found.setflags(write=False)
        known[key] = found
    return known[key]  # type: ignore[no-any-return]
