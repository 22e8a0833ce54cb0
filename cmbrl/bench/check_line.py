"""One measurement of ``cmbrl check``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """Its name, its value, the limit it should keep to, if there is one, and what it means."""

    name: str
    value: float
    limit: float | None
    meaning: str

    @property
    def holds(self) -> bool:
        """Whether the value keeps to the limit."""
        return self.limit is None or self.value <= self.limit
