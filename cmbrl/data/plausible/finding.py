"""A fault that a check has found in a log."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One line that names the column and the likely cause. ``sure``: the log cannot be used as it is."""

    text: str
    sure: bool = True
