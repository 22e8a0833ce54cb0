"""A parameter after the fit."""

from __future__ import annotations

from dataclasses import dataclass

_ROUNDING = 1e-9  # of an interval: what is less is 0
FITTED, AT_BOUND, FLAT, NOMINAL = "fitted", "at bound", "flat", "nominal"


@dataclass(frozen=True)
class FittedParameter:
    """A parameter after the fit, in its own unit; ``low`` and ``high`` bound its 95 % interval.

    ``status``: "fitted"; "at bound"; "flat" (fitted, but the data hardly inform it, so it stayed near its prior);
    "nominal" (not fitted: not chosen, or not needed by the held-out data).
    """

    value: float
    low: float
    high: float
    nominal: float
    status: str
    unit: str = ""

    @property
    def shown(self) -> float:
        """The value, and 0 where it is one but for rounding."""
        return self.value if abs(self.value) > _ROUNDING * (self.high - self.low) else 0.0
