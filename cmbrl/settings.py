"""Fields of a configuration dataclass that carry their own help text and bounds.

``cmbrl train --help`` lists them, and ``--set name=value`` is checked against them.
"""

from __future__ import annotations

from dataclasses import field
from typing import TypeVar

T = TypeVar("T")


def setting(default: T, help: str, *, least: float | None = None, above: float | None = None) -> T:
    """A dataclass field with a default and a help text.

    ``least`` and ``above``: the smallest value allowed, and a value that must be exceeded, element by element for a
    tuple; None where there is no such bound.
    """
    found: T = field(default=default, metadata={"help": help, "least": least, "above": above})
    return found
