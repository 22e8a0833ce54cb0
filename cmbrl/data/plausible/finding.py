"""A fault that a check has found in a log, and what becomes of it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cmbrl.errors import UserError

_TRUSTED = [False]


@dataclass(frozen=True)
class Finding:
    """One line that names the column and the likely cause. ``sure``: the log cannot be used as it is."""

    text: str
    sure: bool = True

    def tell(self) -> None:
        """Raises UserError if it is sure and :func:`trusting` is not in force, else warns."""
        if self.sure and not _TRUSTED[-1]:
            raise UserError(f"{self.text} (if the log is right all the same: --trust-log)")
        warnings.warn(self.text, stacklevel=1)  # of one place: told once, however often the log is checked


@contextmanager
def trusting() -> Iterator[None]:
    """Logs are taken for right: what their numbers show to be wrong is warned of, and nothing is refused for it."""
    _TRUSTED.append(True)
    try:
        yield
    finally:
        _TRUSTED.pop()
