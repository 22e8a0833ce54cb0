"""Which law of sliding a log supports: exact Coulomb or MuJoCo's convex one, where the model leaves it open.

At the file's parameters the wrong law may do as well as the right one, because all else is wrong too; a fit then makes
up for it with friction and softness that no other log bears. So both laws are fitted first, all parameters by a few
steps of Gauss-Newton over one horizon, and held-out episodes decide; where they hardly do, both fits go on before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cmbrl.fitting.evidence import Evidence
from cmbrl.fitting.survey import Surveyor
from cmbrl.models.complementarity import ComplementarityModel

_CLEARLY_BETTER = 0.97  # times the error under the own law
_OPEN = 0.9, 1.1  # between these, short fits say little: the wrong law shows when all else is right
_STEPS = 4  # of the fits, at most where there is a choice: contacts show in them, and impacts do not rule
_WORDS = {"coulomb": "exact Coulomb", "convex": "the convex law, MuJoCo's"}


@dataclass(frozen=True)
class Sliding:
    """``evidence`` under the law that the log supports; ``told``: of the choice, for the report, if there was one.

    ``z`` (n,): how far a fit of positions has gone under that law; None for states, whose survey goes there.
    """

    evidence: Evidence
    told: dict[str, Any] | None = None
    z: np.ndarray | None = None


def other_laws(evidence: Evidence) -> ComplementarityModel | None:
    """The model of ``evidence`` under the other law of sliding; None where that was named, or nothing slides.

    Of positions, also with what goes with that law by default: when a contact acts, and which shapes touch.
    """
    other = evidence.model.other_sliding()
    return other.with_settings(look_ahead=None) if other is not None and evidence.positions_only else other


def supported_sliding(surveyor: Surveyor, horizons: tuple[int, ...]) -> Sliding:
    """The law of sliding that the log supports.

    The other law is taken if it is clearly better after both have been fitted. There is nothing to choose where both
    predict the log alike, as of a robot that touches nothing.
    """
    own, other = surveyor.evidence, surveyor.evidence.model.other_sliding()
    model = other_laws(own)
    steps = max((h for h in surveyor.possible(horizons) if h <= _STEPS), default=min(horizons))
    if other is None or model is None or surveyor.same(other, steps):
        return Sliding(own)
    rival = replace(surveyor, evidence=replace(own, model=model), label=label(model.sliding))
    error = _relative_error(rival, surveyor, steps)
    longer = _OPEN[0] < error < _OPEN[1]
    if longer:
        error = _relative_error(rival, surveyor, steps, longer=True)
    taken = error < _CLEARLY_BETTER
    told = {"tried": model.sliding, "relative_error": error, "taken": taken}
    best = rival if taken else surveyor
    return Sliding(best.evidence, told, best.fitted_to(steps, longer) if own.positions_only else None)


def _relative_error(rival: Surveyor, own: Surveyor, steps: int, longer: bool = False) -> float:
    return float(np.exp(rival.score_after(steps, longer) - own.score_after(steps, longer)))


def label(law: str) -> str:
    """What the journal's units of a fit under this law, in place of the model's own, begin with."""
    return f"{law}: "


def sliding_told(row: Mapping[str, Any] | None) -> str | None:
    """One line on the law of sliding of the fit, or None."""
    if row is None:
        return None
    tried, left = _WORDS[row["tried"]], f"{row['relative_error']:.2f} of the held-out error"
    if row["taken"]:
        return f"law of sliding: {tried}, which left {left} when both laws were fitted; --sliding names another"
    kept = next(words for law, words in _WORDS.items() if law != row["tried"])
    return f"law of sliding: {kept}; {tried} left {left} when both were fitted"
