"""What a fit says where held-out seconds call for other gains than a log tells.

A driver may scale its gains, or a log may tell those of another robot. A target without velocity makes kd and the
joint's damping one number, so what a joint brakes by is told, and how it divides is the prior's; or, where kd is held,
the log's. A drive that answers late brakes less than its kd, by kp times that (``outcome.inner_lag``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cmbrl.fitting.fitted_parameter import FITTED, NOMINAL, FittedParameter

GAINS = ("kd", "kp")  #: groups that a log may tell
_SUM = " Of kd and damping a log of such targets tells the sum only, so that either may be off by what the other is."


def gains_told(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any]) -> str | None:
    """One line where gains that the log tells were moved; else None."""
    sentences = []
    for group in moved_later(report):
        own = [p for name, p in parameters.items() if name.partition(".")[0] == group and p.nominal > 0.0]
        if own:
            factors = np.array([p.value / p.nominal for p in own])
            usual, least, most = np.median(factors), factors.min(), factors.max()
            sentences.append(
                f"Unseen seconds call for another {group} than the log tells: {usual:.2g} times as large "
                f"({least:.2g} to {most:.2g} by joint).{_SUM + _late(parameters) if group == 'kd' else ''}"
            )
    return " ".join(sentences) or None


def _late(parameters: Mapping[str, FittedParameter]) -> str:
    """How late drives of the gains that a log tells would have to answer, to brake as little as the fit does."""
    kd = {name.partition(".")[2]: p for name, p in parameters.items() if name.startswith("kd.") and p.nominal > 0.0}
    stiff = {servo: parameters.get(f"kp.{servo}") for servo in kd}
    late = [(p.nominal - p.value) / kp.value for servo, p in kd.items() if (kp := stiff[servo]) is not None]
    usual = 1e3 * float(np.median(late)) if late else 0.0
    if not usual > 0.0:
        return ""
    return f" Drives with the kd that is told would brake so if they answered {usual:.2g} ms late within their loops."


def sum_told(parameters: Mapping[str, FittedParameter]) -> str | None:
    """One line where dampings were fitted beside a kd that was held, which their intervals rest on; else None."""
    by_group: dict[str, list[FittedParameter]] = {}
    for name, p in parameters.items():
        by_group.setdefault(name.partition(".")[0], []).append(p)
    gains = [p for p in by_group.get("kd", []) if p.nominal > 0.0]
    if not gains or any(p.status != NOMINAL for p in gains):
        return None
    if not any(p.status == FITTED for p in by_group.get("damping", [])):
        return None
    return (
        "kd was held, and of kd and damping motion tells the sum: values and intervals of damping are right as far as "
        "kd is, and what kd lacks they have"
    )


def moved_later(report: Mapping[str, Any]) -> list[str]:
    """Those groups of gains that were held at first, and stayed moved."""
    moves = [(step["move"], step["group"].split(" + ")) for step in report["selection"] or ()]
    last = {group: move for move, groups in moves for group in groups if group in GAINS}
    return [group for group in GAINS if last.get(group) == "add"]
