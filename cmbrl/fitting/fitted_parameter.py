"""A parameter after the fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

_ROUNDING = 1e-9  # of an interval: what is less is 0
FITTED, AT_BOUND, FLAT, NOMINAL = "fitted", "at bound", "flat", "nominal"


@dataclass(frozen=True, eq=False)
class FittedParameter:
    """A parameter after the fit, in its own unit; ``low`` and ``high`` bound its 95 % interval.

    ``status``: "fitted"; "at bound"; "flat" (fitted, but the data hardly inform it, so it stayed near its prior);
    "nominal" (not fitted: not chosen, or not needed by the held-out data). The last has no interval, since nothing says
    how far it may be off: NaN, in JSON null.
    """

    value: float
    low: float
    high: float
    nominal: float
    status: str
    unit: str = ""

    def __eq__(self, other: object) -> bool:
        """Two that have no interval are alike in that, which NaNs are not."""
        return isinstance(other, FittedParameter) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]

    @property
    def shown(self) -> float:
        """The value, and 0 where it is one but for rounding."""
        return 0.0 if abs(self.value) <= _ROUNDING * (self.high - self.low) else self.value

    @property
    def most(self) -> float:
        """The upper end of its interval; the value where it has none."""
        return self.value if math.isnan(self.high) else self.high

    def to_dict(self) -> dict[str, Any]:
        """JSON types; the inverse is ``from_dict``."""
        return {name: None if isinstance(x, float) and math.isnan(x) else x for name, x in asdict(self).items()}

    @classmethod
    def from_dict(cls, saved: Mapping[str, Any]) -> Self:
        """Inverse of ``to_dict``. Raises TypeError for other fields."""
        fields: dict[str, Any] = {name: math.nan if x is None else x for name, x in saved.items()}
        return cls(**fields)
