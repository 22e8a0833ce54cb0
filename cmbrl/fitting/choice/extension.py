"""Fits of positions move everything, and add those laws of friction, motors and servos that held-out errors call for.

What one law explains, another would explain a little: the order is by gain, and who is late has to gain still. What a
large error hides shows beside the law that explains it: a law that gained nothing is tried again.

The prior is first weighed by the errors of the file. By the smaller ones that a fit leaves it weighs less, and dozens
of parameters go on to explain what none of them causes. So its weight falls only where unseen seconds are predicted
clearly better then. What is compared weighs it alike: a lesser weight is no gain of a law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cmbrl.fitting.choice import drives
from cmbrl.fitting.choice.forecast import Forecast
from cmbrl.fitting.choice.leads import BEGUN, as_controlled
from cmbrl.fitting.choice.parsimony import ALL
from cmbrl.fitting.choice.told_gains import GAINS
from cmbrl.fitting.choice.trials import Incumbent, Trial, Trials
from cmbrl.fitting.search.folds import LEAST_GAIN, NOISE_FACTOR, typical_rise
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss_values import Errors
from cmbrl.fitting.search.objective import NotFinite, Objective
from cmbrl.models.between.parameters import AHEAD, DEAD, INTEGRAL, INTEGRATED, LEAD, OFFSET, ZERO
from cmbrl.scene.fittable.parameters import TILT

#: act in proportion; to first order, dry friction takes the part of Stribeck's
_FORECAST = (*GAINS, AHEAD, LEAD, INTEGRAL, DEAD, OFFSET, TILT, ZERO, "friction_slope")
#: tried on positions: held, or in no file
LAWS = (*GAINS, AHEAD, LEAD, INTEGRAL, DEAD, OFFSET, TILT, *drives.GROUPS, ZERO, "friction_slope", "stribeck")
_WITH = {INTEGRAL: (INTEGRATED,)}  # what a law needs besides
_RIVAL = {INTEGRAL: ZERO}  # a simpler law, which is what a law needs besides by itself: it has to gain over that
_AT_ONCE = 0.5  # of the loss: a law that leaves less is taken before others are tried
_WRONG = 0.3  # of the loss, by which it falls with a gain that the log tells wrongly
_OF_A_LAW = 0.1  # of the loss, at least: several are tried, and each holds where no log has been
_OF_A_MEAN = 3.0  # times its noise: a few windows may rule it
_STANDS_FOR = frozenset({drives.GAP})  # friction, in the typical part of a log, where joints move: the mean has to fall
_SETTLING = 2  # times that a fit of everything goes on before laws are added to it


@dataclass(frozen=True)
class Extension(Trials):
    """Laws besides what a fit moves by default, and their confirmation beside all that came later."""

    holds: bool = True

    def extend(self, incumbent: Incumbent, chosen: np.ndarray) -> None:
        """Moves all of ``chosen`` (n,), and those laws besides that held-out errors call for, the best one first."""
        none = np.zeros_like(chosen)
        before = self._unmoved(incumbent)
        self._tell(incumbent, "fitting all parameters")
        start = incumbent.begin if incumbent.surveyed is None else incumbent.surveyed
        least = Objective.at(self.loss, self.space, chosen, incumbent.begin).variance
        trial = self._trial("all", incumbent, chosen, start, none, before, self.budget.polish_iterations, least)
        trial = self._released("all", trial, incumbent, before, self.budget.polish_iterations, least)
        name, incumbent.least = ALL, trial.variance
        for law in drives.FIRST:
            if (limited := self._limited(law, incumbent, chosen, trial)) is not None:
                name, trial = f"{ALL} + {law}", limited
        before = self._accept("add", name, trial, incumbent)
        held = set(np.array(self.space.groups)[~chosen].tolist())
        laws = [law for law in LAWS if law in held]
        while True:
            before = self._settled(incumbent, before)
            incumbent.z, idle = drives.without_unneeded(self.loss, self.space, incumbent.z, incumbent.active)
            incumbent.active = incumbent.active & ~idle
            found: dict[str, Trial] = {}
            for law in self._hopeful(incumbent, laws, before):
                tried = self._law(incumbent, law, before)
                if tried is None or not self._helps(tried, before, law):
                    continue
                if self._beats_rival(incumbent, tried, law, laws, before):
                    found[law] = tried
                    if tried.errors.mean < _AT_ONCE * before.mean:  # no other explains as much
                        break
            if not found:
                return
            best = max(found, key=lambda law: found[law].gain)
            before = self._accept("add", best, found[best], incumbent)
            laws.remove(best)

    def confirm(self, incumbent: Incumbent, groups: list[str]) -> None:
        """Takes ``groups`` back to nominal, all of them, unless held-out errors call for them.

        In the mean of all, or in the typical part of the log. Leads that are no controller's go in any case.
        """
        columns = self.space.columns(groups)
        none = np.zeros_like(columns)
        self.journal.report(0.85, f"confirming {', '.join(groups)}")
        kept = self._trial(
            f"confirmed {groups}", incumbent, incumbent.active, incumbent.z, none, self._unmoved(incumbent)
        )
        start = drives.rubbing(self.loss, self.space, kept.z, np.where(columns, 0.0, kept.z))
        without = self._trial(f"refuted {groups}", incumbent, incumbent.active & ~columns, start, none, kept.errors)
        needed = not _STANDS_FOR.intersection(groups) and self._typically_worse(kept.errors, without.errors)
        strange = LEAD in groups and not as_controlled(self.loss, self.space.theta(kept.z))
        if strange or (not needed and without.costs_nothing(kept.errors.mean, kept.score, kept.strain)):
            self._accept("remove", " + ".join(groups), without, incumbent)

    def _beats_rival(self, incumbent: Incumbent, trial: Trial, law: str, laws: list[str], before: Errors) -> bool:
        """Whether a ``law`` gains over its rival, too, if that is among ``laws`` and helps."""
        rival = _RIVAL.get(law)
        other = self._law(incumbent, rival, before) if rival in laws else None
        if rival is None or other is None or not self._helps(other, before, rival):
            return True
        return self._helps(replace(trial, gain=trial.gain - other.gain), other.errors, law)

    def _helps(self, trial: Trial, before: Errors, law: str = "") -> bool:
        """Whether a law lowers the mean of all or the errors in the typical part of the log, and these do not rise."""
        if law in GAINS and trial.gain < _WRONG * before.mean:
            return False
        if law == LEAD and not as_controlled(self.loss, self.space.theta(trial.z), BEGUN):
            return False
        share, factor = (_OF_A_LAW, _OF_A_MEAN) if law else (LEAST_GAIN, NOISE_FACTOR)
        typical = law not in _STANDS_FOR and self._typically_worse(trial.errors, before, share)
        falls = trial.counts(before.mean, share, factor) or typical
        explodes = not np.isfinite(trial.gain)
        return falls and not explodes and not self._typically_worse(before, trial.errors)

    def _typically_worse(self, one: Errors, other: Errors, share: float = LEAST_GAIN) -> bool:
        """Whether most of the log is predicted clearly worse with the ``other`` errors."""
        rise, noise = typical_rise(one.loss, other.loss, self.folds.blocks())
        return rise > max(NOISE_FACTOR * noise, share)

    def _limited(self, law: str, incumbent: Incumbent, chosen: np.ndarray, rival: Trial) -> Trial | None:
        """A fit of ``chosen`` with a ``law`` of limits from the first, if the file lacks it clearly and it is better.

        Where motors saturate, a fit without limits ends far from where it should. ``rival``: the best fit so far.
        """
        self._tell(incumbent, f"trying {law}")
        start, helps = self._scan(law, incumbent.begin, drives.CLEARLY)
        if not helps.any():
            return None
        begun = self._ahead(f"limited by {law}", incumbent, chosen | helps, start, rival.z)
        if begun is None:
            return None
        none, iterations = np.zeros_like(chosen), self.budget.polish_iterations
        trial = self._trial(f"all limited by {law}", incumbent, chosen | helps, begun, none, rival.errors, iterations)
        return trial if self._helps(trial, rival.errors, law) else None

    def _ahead(
        self, name: str, incumbent: Incumbent, active: np.ndarray, start: np.ndarray, rival: np.ndarray
    ) -> np.ndarray | None:
        """Where a short fit of ``active`` leads from ``start`` (n,); None if ``rival`` (n,) explains the log as well.

        Limits that are true show at once. Others make up for gains and friction of the file, which a full fit finds.
        """

        def compute() -> dict[str, Any]:
            self.journal.check_time()
            try:
                objective = Objective.at(self.loss, self.space, active, start, incumbent.least)
                z = gauss_newton(objective, start, self.budget.trial_iterations, self.journal).z
            except NotFinite:
                return {"z": None}
            own, other = (self.loss.errors(theta).mean for theta in self.space.theta(np.stack([z, rival])))
            return {"z": z.tolist() if own < (1.0 - LEAST_GAIN) * other else None}

        with np.errstate(all="ignore"):
            z = self.journal.unit(f"{name}, shortly", compute)["z"]
        return None if z is None else np.array(z)

    def _scan(self, group: str, z: np.ndarray, least: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """The best levels of ``group`` from ``z`` (n,), and the mask (n,) of the parameters that help."""
        self.journal.check_time()
        return drives.scanned(group, self.loss, self.space, z, least)

    def _settled(self, incumbent: Incumbent, before: Errors) -> Errors:
        """Fits on as long as that helps: what comes next must not gain by more iterations alone."""
        none = np.zeros_like(incumbent.active)
        self._tell(incumbent, "fitting all parameters further")
        for again in range(_SETTLING):
            name, at = f"settle {len(incumbent.path)} {again}", (incumbent.active, incumbent.z, none, before)
            trial = self._trial(name, incumbent, *at, least=0.0)
            if self._typically_worse(trial.errors, before) or trial.counts(before.mean):
                incumbent.z, incumbent.least, before = trial.z, trial.variance, trial.errors
                continue
            trial = self._trial(f"{name}, weight kept", incumbent, *at)
            if trial.errors.mean < before.mean:
                incumbent.z, before = trial.z, trial.errors
            break
        return before

    def _hopeful(self, incumbent: Incumbent, laws: list[str], before: Errors) -> list[str]:
        """Those of ``laws`` that may gain what counts, by a forecast, the best ones first; then those without one."""
        told = [law for law in laws if law in _FORECAST]
        if not told:
            return laws
        self.journal.check_time()
        objective = Objective.at(self.loss, self.space, incumbent.active, incumbent.z, incumbent.least)
        forecast = Forecast.at(self.folds, self.space, incumbent.z, objective.strength)
        already, columns = forecast.gain(incumbent.active), {law: self._columns(law) for law in told}
        gains = {law: forecast.gain(incumbent.active | own) - already for law, own in columns.items()}
        idle = {
            law for law, own in columns.items()
            if not forecast.blank(own) and gains[law] < (_WRONG if law in GAINS else LEAST_GAIN) * before.mean
        }  # fmt: skip
        return sorted((law for law in laws if law not in idle), key=lambda law: -gains.get(law, -np.inf))

    def _columns(self, law: str) -> np.ndarray:
        """Mask (n,) of the parameters of a ``law`` and of what it needs besides."""
        return self.space.columns([law, *_WITH.get(law, ())])

    def _law(self, incumbent: Incumbent, group: str, before: Errors) -> Trial | None:
        """A fit with the law of ``group`` besides; None if nothing of it lowers the loss of what it is fitted to."""
        if group not in drives.GROUPS and group not in _FORECAST:
            return self._added(incumbent, [group], before)
        self._tell(incumbent, f"trying {group}")
        name, helps, start = f"add {len(incumbent.path)} {group}", self._columns(group), None
        if group in drives.GROUPS:
            start, helps = self._scan(group, incumbent.z, LEAST_GAIN)
        else:
            start = self._ahead(name, incumbent, incumbent.active | helps, incumbent.z, incumbent.z)
        if start is None or not helps.any():
            return None
        return self._trial(name, incumbent, incumbent.active | helps, start, np.zeros_like(helps), before)
