"""Which laws of contact a log supports, where they are open: exact Coulomb, MuJoCo's convex law, or its whole step.

At the file's parameters the wrong law may do as well as the right one, because all else is wrong too; a fit then makes
up for it with friction and softness that no other log bears. So all laws are fitted first, all parameters by a few
steps of Gauss-Newton over a few steps, and held-out episodes decide; where they hardly do, the fits go on before, over
more steps if the log has noise. Of positions they go on where the own law has led: fits under MuJoCo's step, which has
jumps, learn more slowly, and may lag behind the wrong law from the file on.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.survey import Surveyor
from cmbrl.fitting.state import OutOfTime
from cmbrl.models.complementarity import ComplementarityModel

_CLEARLY_BETTER = 0.97  # times the error under the own law
_OPEN = 0.9, 1.1  # between these, short fits say little: the wrong law shows when all else is right
_LAGGING = 3.0  # the same above, of positions
_FIRST = 0.5  # of the time, for the rival that is fitted first
_STEPS = 4  # of the first fits, at most: contacts show in them, and impacts do not rule
_OWN = "own"
_WORDS = {
    "coulomb": "exact Coulomb",
    "convex": "the convex law, MuJoCo's",
    "mujoco": "MuJoCo's step (the convex law, rows that act once they are closed, the file's integrator, no smoothing)",
}


@dataclass(frozen=True)
class Sliding:
    """``evidence`` under the law that the log supports; ``told``: of the choice, for the report, if there was one.

    ``z`` (n,): how far a fit of positions has gone under that law; None for states, whose survey goes there.
    """

    evidence: Evidence
    told: dict[str, Any] | None = None
    z: np.ndarray | None = None


@dataclass(frozen=True)
class _Trial:
    """Fits of rivals and of the own law, ``longer`` or not, and what they leave relative to the own; none: no time."""

    rivals: Mapping[str, Surveyor]
    own: Surveyor
    errors: dict[str, float]
    longer: bool = False

    @classmethod
    def of(cls, rivals: Mapping[str, Surveyor], own: Surveyor, steps: int, longer: bool = False) -> _Trial:
        return cls(rivals, own, _relative_errors(rivals, own, steps, longer), longer)

    def again(self, steps: int) -> _Trial:
        """Fits of those that may still be better, going on; as it is, where errors are clear or time is up."""
        positions = self.own.evidence.positions_only
        most = _LAGGING if positions else _OPEN[1]
        if not _OPEN[0] < min(self.errors.values()) < most:
            return self
        near = {name: self.rivals[name] for name, error in self.errors.items() if error < most}
        own = self.own
        if positions:
            led = own.fitted_to(steps)
            own, near = own.going_on(led), {name: one.going_on(led) for name, one in near.items()}
        found = _Trial.of(near, own, steps, longer=not positions)
        return found if found.errors else self


def rivals(evidence: Evidence) -> dict[str, ComplementarityModel]:
    """The model of ``evidence`` under other laws, by name; of positions, whose fits take long, MuJoCo's step alone."""
    found = evidence.model.rivals()
    return {"mujoco": found["mujoco"]} if evidence.positions_only and "mujoco" in found else found


def supported_sliding(surveyor: Surveyor, horizons: tuple[int, ...]) -> Sliding:
    """The laws that the log supports.

    Another law is taken if it is clearly better after all have been fitted. There is nothing to choose where they
    predict the log alike, as of a robot that touches nothing. When time is up, laws that have been fitted are compared.
    """
    own = surveyor.evidence
    steps = max((h for h in surveyor.possible(horizons) if h <= _STEPS), default=min(horizons))
    tried = {
        name: replace(surveyor, evidence=replace(own, model=model), label=label(name))
        for name, model in rivals(own).items()
        if not surveyor.same(model, steps)
    }
    if not tried:
        return Sliding(own)
    trial = _Trial.of(tried, surveyor, steps)
    if not trial.errors:
        return Sliding(own)
    trial = trial.again(steps)
    best = min(trial.errors, key=trial.errors.__getitem__)
    taken = trial.errors[best] < _CLEARLY_BETTER
    told = {"tried": best, "own": own.model.sliding, "relative_error": trial.errors[best], "taken": taken}
    chosen = trial.rivals[best] if taken else trial.own
    return Sliding(chosen.evidence, told, chosen.fitted_to(steps, trial.longer) if own.positions_only else None)


def _relative_errors(
    rivals: Mapping[str, Surveyor], own: Surveyor, steps: int, longer: bool = False
) -> dict[str, float]:
    """Of each of the ``rivals``, as far as there is time.

    The first of them is fitted first. Where a law explains the log, no other can be clearly better: the own is fitted
    plainly, to compare, or not at all when time is up, and those that would follow are not.
    """
    scores = _scores_after_more(rivals, own, steps) if longer else _scores(rivals, own, steps)
    before = scores.pop(_OWN, None)
    if before is None:
        return {}
    return {name: float(np.nan_to_num(np.exp(score - before), nan=np.inf)) for name, score in scores.items()}


def _scores(rivals: Mapping[str, Surveyor], own: Surveyor, steps: int) -> dict[str, float]:
    """Held-out errors by law, after fits over as many steps as there was time for under both of the first two."""
    first, *others = rivals
    with own.journal.within(_FIRST):
        theirs = rivals[first].in_time(steps)
    explained = steps in theirs and rivals[first].explains(steps, theirs[steps])
    ours = (own.plain if explained else own).in_time(steps)
    if explained and steps not in ours:
        return {first: rivals[first].score_at(theirs[steps]), _OWN: own.score_before()}
    both = theirs.keys() & ours.keys()
    if not both:
        return {}
    h = max(both)
    scores = {first: rivals[first].score_at(theirs[h]), _OWN: own.score_at(ours[h])}
    if h == steps and not explained and not own.explains(steps, ours[steps]):
        for name in others:
            if steps in (found := rivals[name].in_time(steps)):
                scores[name] = rivals[name].score_at(found[steps])
    return scores


def _scores_after_more(rivals: Mapping[str, Surveyor], own: Surveyor, steps: int) -> dict[str, float]:
    """The same where longer fits lead; of some laws only, or none, when time is up."""
    scores: dict[str, float] = {}
    with suppress(OutOfTime):
        for name, one in {**rivals, _OWN: own}.items():
            scores[name] = one.score_at(one.fitted_to(steps, longer=True))
    return scores


def label(law: str) -> str:
    """What the journal's units of a fit under this law, in place of the model's own, begin with."""
    return f"{law}: "


def sliding_told(row: Mapping[str, Any] | None) -> str | None:
    """One line on the law of sliding of the fit, or None."""
    if row is None:
        return None
    tried, left = _WORDS[row["tried"]], f"{row['relative_error']:.2f} of the held-out error"
    if row["taken"]:
        return f"law of sliding: {tried}, which left {left} when all were fitted; --sliding names another"
    kept = _WORDS[row.get("own", "coulomb")]
    return f"law of sliding: {kept}; {tried} left {left} when all were fitted"
