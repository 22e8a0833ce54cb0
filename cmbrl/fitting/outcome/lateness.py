"""Delay and lag of commands together: slow motion tells by how much the robot is late, but hardly in which way.

A delay d and a first-order lag tau shift slow motion by d + tau. Only motion as fast as 1 / tau tells one from the
other, so that each may take the other's part, within an interval of its own that says little of the sum. A model of
time step h takes a servo's position at the beginning or the end of a step: that is as good as h / 2 more or less.

Commands that move on between the samples of a log, as a faster controller's do, are ahead of what is held from one
sample to the next by half a step of the log.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cmbrl.fitting.search.space import Space
from cmbrl.models.between.parameters import AHEAD, DELAY, LAG

_NORMAL_95 = 1.96
_NARROWER = 0.5  # than the narrower of the two intervals: else the sum says nothing new


def sum_of_lateness(space: Space, z: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """By how much commands act late in all, and its standard deviation [s], at ``z`` (n,).

    Negative where they act before they are logged. ``covariance`` (n, n) in z, zero for what is not fitted.
    """
    signs = 1.0 * np.isin(space.groups, [DELAY, LAG]) - np.isin(space.groups, [AHEAD])
    slope = signs * space.slope(z)
    return float(signs @ space.theta(z)), float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def lateness(space: Space, z: np.ndarray, covariance: np.ndarray, step: float) -> dict[str, float] | None:
    """Delay and lag of the commands in one [s]: "value", "low" and "high" (95 %), if the log tells their sum better.

    Also where commands act clearly before they are logged, and then "ahead" is True. ``covariance`` (n, n) in z, zero
    for what is not fitted; ``step``: that of the model [s]. Else None where one of the two was not fitted, or where
    each is told about as well as the sum.
    """
    own = np.flatnonzero(np.isin(space.groups, [DELAY, LAG]))
    early = np.flatnonzero(np.isin(space.groups, [AHEAD]))
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if len(own) != 2 or not (deviations[own].all() or deviations[early].any()):
        return None
    value, deviation = sum_of_lateness(space, z, covariance)
    half = float(np.hypot(_NORMAL_95 * deviation, 0.5 * step))
    ahead = value + half < -step
    apart = _NORMAL_95 * (deviations * space.slope(z))[own].min()
    if not ahead and not (deviations[own].all() and half < _NARROWER * apart):
        return None
    least = -float(space.high[early].sum()) if ahead else 0.0
    return {"value": value, "low": max(value - half, least), "high": max(value + half, least), "ahead": ahead}


def lateness_told(report: Mapping[str, Any]) -> str | None:
    """One line on ``report["lateness"]``; None where there is nothing to say."""
    found = report.get("lateness")
    if not found:
        return None
    value, low, high = (1e3 * found[name] for name in ("value", "low", "high"))
    both = f"delay + lag{' - ahead' * bool(found.get('ahead'))}, interval [{low:.3g}, {high:.3g}]"
    if found.get("ahead"):
        return (
            f"commands act {-value:.3g} ms before they are logged ({both}): they move on between the log's samples, or "
            "are logged late; a policy's act at once"
        )
    if not low > 0.0:
        return f"commands act at once, or at most {high:.3g} ms late ({both})"
    return (
        f"commands act {value:.3g} ms late ({both}); how much of it is delay and how much lag, motion as slow as the "
        "log's hardly tells"
    )
