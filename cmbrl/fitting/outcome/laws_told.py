"""Laws besides the file's that a fit took, though the log tells none of their values from 0: said, since they mislead.

Held-out errors decide which laws a fit takes. What friction by place or speed lowers them by may be what time stepping
leaves of plain friction, spread over all joints. Then no single value is far from 0, and none should be believed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cmbrl.fitting.choice.drives import GAP
from cmbrl.fitting.fitted_parameter import AT_BOUND, FITTED, NOMINAL, FittedParameter
from cmbrl.models.between.parameters import DEAD, INTEGRAL, OFFSET, RAMP, ZERO

_FRICTION, _OTHER = "what time steps leave of plain friction", "something else that the model lacks"
_LAWS = {
    "friction_slope": ("friction by place", _FRICTION),
    "stribeck": ("friction that falls with speed", _FRICTION),
    GAP: ("backlash", _FRICTION),
    ZERO: ("zeros of servos", _OTHER),
    OFFSET: ("zeros of motors", _OTHER),
    DEAD: ("dead zones", _OTHER),
    INTEGRAL: ("servos that integrate", _OTHER),
    RAMP: ("targets of limited rate", _OTHER),
}
_NAMED = 6


def doubtful_laws(parameters: Mapping[str, FittedParameter]) -> list[str]:
    """Groups of laws, 0 in the file, that moved and of which every interval holds 0."""
    found = []
    for group in _LAWS:
        own = [p for name, p in parameters.items() if name.partition(".")[0] == group and p.status != NOMINAL]
        if own and all(p.low <= p.nominal <= p.high for p in own):
            found.append(group)
    return found


def laws_told(parameters: Mapping[str, FittedParameter], report: Mapping[str, Any]) -> str | None:
    """One line on such laws, where the fit took them by itself; else None."""
    taken = {group for step in report.get("selection") or () for group in step["group"].split(" + ")}
    doubtful = [group for group in doubtful_laws(parameters) if group in taken]
    if not doubtful:
        return None
    named = " and ".join(f"{_LAWS[group][0]} ({group})" for group in doubtful)
    reasons = " or ".join(dict.fromkeys(_LAWS[group][1] for group in doubtful))
    return (
        f"Held-out errors are smaller with {named}, but no value of it is told from 0: do not take it for something "
        f"that the robot has. It may stand for {reasons}."
    )


def ramps_told(parameters: Mapping[str, FittedParameter]) -> str | None:
    """One line on the rates at which targets of servos follow their commands, where a fit found some; else None."""
    own = {name.partition(".")[2]: p for name, p in parameters.items() if name.partition(".")[0] == RAMP}
    told = [(name, p) for name, p in own.items() if p.status == FITTED and p.low > 0.0]
    if not told:
        return None
    rates = [f"{name} {1.0 / p.value:.3g} [{1.0 / p.high:.3g}, {1.0 / p.low:.3g}]" for name, p in told[:_NAMED]]
    more = f" and {len(told) - _NAMED} more" if len(told) > _NAMED else ""
    return (
        "targets of servos follow their commands at a limited rate, 1 / ramp, in units of the control a second: "
        f"{', '.join(rates)}{more}"
    )


def play_told(parameters: Mapping[str, FittedParameter]) -> str | None:
    """One line on joints whose play the fit has closed; else None."""
    found = {name.partition(".")[2]: p for name, p in parameters.items() if name.partition(".")[0] == "play"}
    closed = [name for name, p in found.items() if p.status == AT_BOUND and p.value < p.nominal]
    if not closed:
        return None
    return (
        f"The log shows no play at {', '.join(closed)}: the gap closed as far as it may. Take it out of the file "
        "(leave it out of `cmbrl convert --play`)."
    )
