"""Whether a fit makes every link heavier than the file does, or lighter: its unit of force may then be wrong.

Motion tells forces and masses up to a common factor. Where gains are held at what the log or the file says, they set
the unit, and a servo that pushes less than its gain says shows as links that are all too heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.outcome.combinations import WEIGHT

_GAINS = ("kp", "gear")  # groups
_LINKS, _SHARE = 4, 0.9  # at least so many, and so many of them to one side
_CLEARLY = 1.2  # times the file's, or less than its inverse
_OF_IT = 0.5  # of that factor, by its logarithm, at least, is what links weigh together off


def unit_told(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any] | None = None) -> str | None:
    """One line where gains are held and nearly all fitted masses lie clearly to one side of the file's; else None.

    None as well where the ``report`` tells what links weigh together at joints, and that is not as far off: single
    masses that the log tells may be those of one kind of link, for which others make up.
    """
    groups: dict[str, list[FittedParameter]] = {}
    for name, p in parameters.items():
        groups.setdefault(name.split(".")[0], []).append(p)
    gains = [p for group in _GAINS for p in groups.get(group, [])]
    factors = np.array([p.value / p.nominal for p in groups.get("mass", []) if p.status == "fitted" and p.nominal > 0])
    if not gains or any(p.value != p.nominal for p in gains) or len(factors) < _LINKS:
        return None
    usual, heavier = float(np.median(factors)), float(np.mean(factors > 1.0))
    if max(heavier, 1.0 - heavier) < _SHARE or max(usual, 1.0 / usual) < _CLEARLY:
        return None
    sums = ((report or {}).get("combinations") or {}).get("rows", ())
    pulls = [(row["value"], row["nominal"]) for row in sums if row["name"].startswith(WEIGHT)]
    weights = [np.log(value / nominal) for value, nominal in pulls if value * nominal > 0.0]
    if weights and float(np.median(weights)) / np.log(usual) < _OF_IT:
        return None
    other = "smaller" if usual > 1.0 else "larger"
    return (
        f"Nearly all links come out at about {usual:.3g} times the file's masses. Gains were held and set the unit of "
        f"force: if the file's masses are right, actuators push {1.0 / usual:.2g} times what their gains say, and all "
        f"other forces are {other} by that factor too."
    )
