"""A parameter after the fit."""

from __future__ import annotations

from dataclasses import dataclass

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
