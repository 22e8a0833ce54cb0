"""The fewest parameters that the data supports: selection by group, judged on episodes held out in turn.

All groups are fitted first. If that beats the nominal model, those that hardly matter are removed, as many at once as
the forecast of ``superfluous`` says and a refit confirms. Groups that say something only together, or that would lead a
search astray one by one, are so never apart. Starting from there or from the nominal model, the remaining groups are
ranked by forecast gain (``forecast``). The first few are tried: a short search over the group's parameters, then Gauss-
Newton over all selected ones. The best group stays if the held-out loss falls by more than ``NOISE_FACTOR`` times its
noise (``folds.paired_gain``; two rather than one, because it is the best of several trials) and by at least
``LEAST_GAIN`` of the loss, because without noise any gain would be significant. Below the solver's accuracy there is
nothing to gain: a file that is right stays as it is.

If no group helps alone, several may help together (masses are uninformative while gears and armatures are held). All
remaining groups enter the forecast, those that contribute less than ``LEAST_GAIN`` leave it one by one, and the rest is
tried as a whole. Groups with zero derivatives (restitution before anything bounces) come last. At the end, groups that
later ones made superfluous are removed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cmbrl.fitting import drives
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.folds import LEAST_GAIN, NOISE_FACTOR, Folds, paired_gain
from cmbrl.fitting.forecast import Forecast, rise, superfluous
from cmbrl.fitting.gauss_newton import gauss_newton
from cmbrl.fitting.loss import Errors, NormalEquations, PredictionLoss
from cmbrl.fitting.objective import SOLVER_VARIANCE, Objective
from cmbrl.fitting.random_search import random_search
from cmbrl.fitting.space import Space
from cmbrl.fitting.state import Journal
from cmbrl.fitting.survey import Judge, score
from cmbrl.fitting.unseen import Unseen

CLEAR_RISE = 2.0  # of the loss, by the forecast: a group whose removal costs so much is not tried
LEAST_SCORE = 0.03  # of the logarithm of the errors over all horizons
LEAST_STRAIN = 2.0  # of the logarithm of the prior: the other parameters may not go far to make up for one that stays
ALL = "all that a fit moves by default"  #: in the path of a selection
LAWS = ("friction_slope", "stribeck")  #: groups that no file has, tried on logs of positions, where friction rules
_STIRS = (-2.0, -0.5, 0.5, 2.0)  # prior standard deviations
_SETTLING = 2  # times that a fit of everything goes on before laws are added to it
TRIED = 3  # groups per round: forecasts are accurate enough for the best to be among the first


@dataclass
class Incumbent:
    """The best parameters so far, returned if the fit is interrupted, and how they were reached.

    ``active`` (n,): the parameters that may move, selected or asked for. ``score``: the best of the path; ``course``:
    by search, its best objective by candidates; ``unseen``: held-out episodes with parameters fitted to the others.
    """

    z: np.ndarray
    active: np.ndarray
    path: list[dict[str, Any]] = field(default_factory=list)
    candidates: int = 0
    score: float = np.inf
    course: list[dict[str, Any]] = field(default_factory=list)
    unseen: Unseen | None = None


@dataclass(frozen=True)
class Trial:
    """A fit with some groups more or less: its held-out ``errors``, the fall of the loss and the noise of that fall.

    ``noise_of_rise``: the noise if the loss were to rise by chance only. ``score``: the mean logarithm of the held-out
    errors at all horizons (``survey``). ``strain``: minus the logarithm of the prior, how far the parameters are from
    the file's: motion tells masses, gears and damping up to a common factor, so that some can make up for others.
    """

    z: np.ndarray
    active: np.ndarray
    errors: Errors
    gain: float
    noise: float
    noise_of_rise: float
    score: float
    strain: float

    def costs_nothing(self, loss: float, score: float, strain: float) -> bool:
        """Whether neither the held-out ``loss``, nor the ``score`` over all horizons, nor the ``strain`` rises."""
        return (
            -self.gain <= max(NOISE_FACTOR * self.noise_of_rise, LEAST_GAIN * loss, 0.5 * SOLVER_VARIANCE)
            and self.score < score + LEAST_SCORE
            and self.strain < strain + LEAST_STRAIN
        )

    def counts(self, loss: float) -> bool:
        """Whether the fall of the held-out ``loss`` exceeds noise and accuracy and is worth a parameter."""
        return self.gain > max(NOISE_FACTOR * self.noise, LEAST_GAIN * loss, 0.5 * SOLVER_VARIANCE)


@dataclass(frozen=True)
class Selection:
    """Forward selection, then elimination. ``loss`` is on all episodes; ``folds`` hold them out in turn.

    ``judges[k]`` predict the episodes that fold k holds out over all horizons.
    """

    space: Space
    loss: PredictionLoss
    folds: Folds
    judges: list[list[Judge]]
    seed: int
    budget: Budget
    journal: Journal

    def run(self, incumbent: Incumbent) -> None:
        """Adds groups to ``incumbent`` and removes superfluous ones; raises the journal's OutOfTime between trials."""
        before = self._unmoved(incumbent)
        before = self._thin(incumbent, self._everything(incumbent, before))
        while (after := self._add(incumbent, before)) is not None:
            before = after
        self._remove(incumbent, before)

    def extend(self, incumbent: Incumbent, chosen: np.ndarray) -> None:
        """Moves all of ``chosen`` (n,), and those laws besides that held-out errors call for, the best one first.

        What one law explains, another would explain a little: the order is by gain, and who is late has to gain still.
        What a large error hides shows beside the law that explains it: a law that gained nothing is tried again.
        """
        none = np.zeros_like(chosen)
        before = self._unmoved(incumbent)
        trial = self._trial("all", incumbent, chosen, incumbent.z, none, before, self.budget.polish_iterations)
        name = ALL
        if (limited := self._limited(incumbent, chosen, trial.errors)) is not None:
            name, trial = f"{ALL} + {drives.LIMIT}", limited
        before = self._accept("add", name, trial, incumbent)
        laws = [law for law in (*drives.GROUPS, *LAWS) if law in self.space.groups]
        while True:
            before = self._settled(incumbent, before)
            idle = drives.unneeded(self.loss, self.space, incumbent.z, incumbent.active)
            incumbent.z, incumbent.active = np.where(idle, 0.0, incumbent.z), incumbent.active & ~idle
            trials = {law: self._law(incumbent, law, before) for law in laws}
            found = {law: t for law, t in trials.items() if t is not None and t.counts(before.mean)}
            if not found:
                return
            best = max(found, key=lambda law: found[law].gain)
            before = self._accept("add", best, found[best], incumbent)
            laws.remove(best)

    def _limited(self, incumbent: Incumbent, chosen: np.ndarray, before: Errors) -> Trial | None:
        """A fit of ``chosen`` with limits of forces from the first, if the file lacks them clearly and it is better.

        Where motors saturate, a fit without limits ends far from where it should.
        """
        start, helps = self._scan(drives.LIMIT, incumbent.z, drives.CLEARLY, lines=False)
        if not helps.any():
            return None
        none, iterations = np.zeros_like(chosen), self.budget.polish_iterations
        trial = self._trial("all limited", incumbent, chosen | helps, start, none, before, iterations)
        return trial if trial.counts(before.mean) else None

    def _scan(self, group: str, z: np.ndarray, least: float = 0.0, lines: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """The best levels of ``group`` from ``z`` (n,), and the mask (n,) of the parameters that help."""
        self.journal.check_time()
        self.journal.report(0.6, f"trying {group}")
        return drives.scanned(group, self.loss, self.space, z, least, lines)

    def _settled(self, incumbent: Incumbent, before: Errors) -> Errors:
        """Fits on as long as that helps: what comes next must not gain by more iterations alone."""
        none = np.zeros_like(incumbent.active)
        for again in range(_SETTLING):
            trial = self._trial(
                f"settle {len(incumbent.path)} {again}", incumbent, incumbent.active, incumbent.z, none, before
            )
            if trial.errors.mean < before.mean:
                incumbent.z, before = trial.z, trial.errors
            if not trial.counts(trial.errors.mean + trial.gain):
                break
        return before

    def _law(self, incumbent: Incumbent, group: str, before: Errors) -> Trial | None:
        """A fit with the law of ``group`` besides; None if no level of those of ``drives`` lowers the loss."""
        if group not in drives.GROUPS:
            return self._try(incumbent, [group], before)
        start, helps = self._scan(group, incumbent.z)
        if not helps.any():
            return None
        active, none = incumbent.active | helps, np.zeros_like(helps)
        return self._trial(f"add {len(incumbent.path)} {group}", incumbent, active, start, none, before)

    def confirm(self, incumbent: Incumbent, groups: list[str]) -> None:
        """Takes ``groups`` back to nominal, all of them, unless held-out errors call for them."""
        columns = self.space.columns(groups)
        none = np.zeros_like(columns)
        kept = self._trial(
            f"confirmed {groups}", incumbent, incumbent.active, incumbent.z, none, self._unmoved(incumbent)
        )
        start = np.where(columns, 0.0, kept.z)
        without = self._trial(f"refuted {groups}", incumbent, incumbent.active & ~columns, start, none, kept.errors)
        if without.costs_nothing(kept.errors.mean, kept.score, kept.strain):
            self._accept("remove", " + ".join(groups), without, incumbent)

    def _unmoved(self, incumbent: Incumbent) -> Errors:
        return self.folds.errors(self.space, [incumbent.z] * len(self.folds.train))

    def _everything(self, incumbent: Incumbent, before: Errors) -> Errors:
        """Starts from all groups if that beats the nominal model, and returns the new errors."""
        groups = self._remaining(incumbent)
        self.journal.report(0.05, "trying all parameters")
        everything, none = self.space.columns(groups), np.zeros_like(incumbent.active)
        iterations = self.budget.polish_iterations
        trial = self._trial("add all", incumbent, everything, incumbent.z, none, before, iterations)
        return self._accept("add", ALL, trial, incumbent) if trial.counts(before.mean) else before

    def _thin(self, incumbent: Incumbent, before: Errors) -> Errors:
        """Removes as many groups at once as the forecast calls superfluous; half as many if a refit disagrees.

        Groups that no prediction depends on leave before, without a refit.
        """
        if not incumbent.active.any():
            return before
        for group in dict.fromkeys(self.space.groups):
            columns = self.space.columns([group])
            if not incumbent.z[columns].any() and self._idle(incumbent.z, columns):
                incumbent.active = incumbent.active & ~columns
        groups, equations = self._active(incumbent), self._equations(incumbent)
        dispensable = superfluous(
            self.space, incumbent.z, incumbent.active, equations, groups, LEAST_GAIN * before.mean
        )
        while dispensable:
            columns = self.space.columns(dispensable)
            start, none = np.where(columns, 0.0, incumbent.z), np.zeros_like(columns)
            self.journal.report(0.2, f"removing {', '.join(dispensable)}")
            name = f"remove {len(incumbent.path)} {' + '.join(dispensable)}"
            trial = self._trial(name, incumbent, incumbent.active & ~columns, start, none, before)
            if trial.costs_nothing(before.mean, incumbent.score, self._strain(incumbent.z)):
                return self._accept("remove", " + ".join(dispensable), trial, incumbent)
            dispensable = dispensable[: len(dispensable) // 2]
        return before

    def _idle(self, z: np.ndarray, columns: np.ndarray) -> bool:
        """Whether the loss stays the same wherever ``columns`` go: contacts of a robot that flies, say."""
        moved = [np.where(columns, step, z) for step in _STIRS]
        points = np.clip(np.stack([z, *moved]), self.space.z_low, self.space.z_high)
        losses = self.loss.values(self.space.theta(points))
        return bool((losses == losses[0]).all())

    def _add(self, incumbent: Incumbent, before: Errors) -> Errors | None:
        """Adds the best group, a set of groups, or a blank one; returns the new errors, or None if nothing helps."""
        strength = Objective.at(self.loss, self.space, incumbent.active, incumbent.z).strength
        forecast = Forecast.at(self.folds, self.space, incumbent.z, strength)

        def promise(groups: Sequence[str]) -> float:
            return forecast.gain(incumbent.active | self.space.columns(groups))

        remaining = self._remaining(incumbent)
        blank = [g for g in remaining if forecast.blank(self.space.columns([g]))]
        ranked = sorted((g for g in remaining if g not in blank), key=lambda g: -promise([g]))
        winner: tuple[str, Trial] | None = None
        for group in ranked[:TRIED]:
            if winner is not None and winner[1].gain >= promise([group]):
                break
            trial = self._try(incumbent, [group], before)
            if trial.counts(before.mean) and (winner is None or trial.gain > winner[1].gain):
                winner = group, trial
        if winner is None and len(together := _needed(ranked, promise, LEAST_GAIN * before.mean)) > 1:
            trial = self._try(incumbent, together, before)
            winner = (" + ".join(together), trial) if trial.counts(before.mean) else None
        for group in blank if winner is None else ():
            if self._idle(incumbent.z, self.space.columns([group])):
                continue
            trial = self._try(incumbent, [group], before)
            if trial.counts(before.mean):
                winner = group, trial
                break
        return None if winner is None else self._accept("add", *winner, incumbent)

    def _remaining(self, incumbent: Incumbent) -> list[str]:
        groups = dict.fromkeys(g for g, told in zip(self.space.groups, self.space.default, strict=True) if told)
        return [g for g in groups if not incumbent.active[self.space.columns([g])].any()]

    def _try(self, incumbent: Incumbent, groups: list[str], before: Errors) -> Trial:
        self.journal.report(0.6 * (1.0 - 0.8 ** len(incumbent.path)), f"trying {', '.join(groups)}")
        columns = self.space.columns(groups)
        name = f"add {len(incumbent.path)} {' + '.join(groups)}"
        return self._trial(name, incumbent, incumbent.active | columns, incumbent.z, columns, before)

    def _remove(self, incumbent: Incumbent, before: Errors) -> None:
        """Removes groups one by one; those whose loss the forecast says is large keep their place without a refit."""
        for group in self._active(incumbent):
            columns = self.space.columns([group])
            rises = rise(incumbent.z, incumbent.active, columns, self._equations(incumbent))
            if rises > CLEAR_RISE * before.mean:
                continue
            self.journal.report(0.6, f"removing {group}")
            start = np.where(columns, 0.0, incumbent.z)
            name = f"remove {len(incumbent.path)} {group}"
            none = np.zeros_like(columns)
            trial = self._trial(name, incumbent, incumbent.active & ~columns, start, none, before)
            if trial.costs_nothing(before.mean, incumbent.score, self._strain(incumbent.z)):
                before = self._accept("remove", group, trial, incumbent)

    def _active(self, incumbent: Incumbent) -> list[str]:
        return [g for g in dict.fromkeys(self.space.groups) if incumbent.active[self.space.columns([g])].any()]

    def _equations(self, incumbent: Incumbent) -> NormalEquations:
        loss = self.loss.settled(self.space.theta(incumbent.z))
        return loss.normal_equations(self.space, incumbent.z, incumbent.active)

    def _accept(self, move: str, group: str, trial: Trial, incumbent: Incumbent) -> Errors:
        incumbent.z, incumbent.active = trial.z, trial.active
        incumbent.score = min(incumbent.score, trial.score)  # many small steps may not lead far
        incumbent.path.append(
            {
                "move": move,
                "group": group,
                "gain": trial.gain,
                "noise": trial.noise,
                "score": trial.score,
                "held_out_loss": trial.errors.mean,
                "held_out_rmse": trial.errors.rmse,
            }
        )
        return trial.errors

    def _trial(
        self,
        name: str,
        incumbent: Incumbent,
        active: np.ndarray,
        start: np.ndarray,
        searched: np.ndarray,
        before: Errors,
        iterations: int | None = None,
    ) -> Trial:
        """Fits ``active`` from ``start``: random search over the ``searched`` ones, then Gauss-Newton over all."""
        budget = self.budget

        def compute() -> dict[str, Any]:
            self.journal.check_time()
            z, candidates = start, 0
            if (active & searched).any():
                objective = Objective.at(self.loss, self.space, active & searched, z)
                found = random_search(
                    objective, z, self.seed, budget.trial_rounds, budget.trial_population, self.journal, name
                )
                z, candidates = found.z, found.candidates
            if active.any():
                objective = Objective.at(self.loss, self.space, active, z)
                found = gauss_newton(objective, z, iterations or budget.trial_iterations, self.journal)
                z, candidates = found.z, candidates + found.candidates
            fitted, more = self.folds.refit(self.space, active, z, budget.trial_fold_iterations, self.journal)
            return {"z": z.tolist(), "folds": [f.tolist() for f in fitted], "candidates": candidates + more}

        outcome = self.journal.unit(name, compute)
        incumbent.candidates += outcome["candidates"]
        z = np.array(outcome["z"])
        fitted = [np.array(f) for f in outcome["folds"]]
        after = self.folds.errors(self.space, fitted)
        gain, noise = paired_gain(before.loss, after.loss, self.folds.blocks())
        noise_of_rise = paired_gain(after.loss, before.loss, self.folds.blocks())[1]
        return Trial(z, active, after, gain, noise, noise_of_rise, self._score(fitted), self._strain(z))

    def _strain(self, z: np.ndarray) -> float:
        return float(0.5 * z @ self.space.precision @ z)

    def _score(self, fitted: list[np.ndarray]) -> float:
        if not self.judges:
            return 0.0
        pairs = zip(self.judges, fitted, strict=True)
        return float(np.mean([score(judges, self.space.theta(z)) for judges, z in pairs]))


def _needed(groups: Sequence[str], promise: Callable[[Sequence[str]], float], least: float) -> list[str]:
    """``groups`` after dropping the least useful one, again and again, as long as that costs less than ``least``."""
    kept = list(groups)
    while kept:
        without = {g: promise([other for other in kept if other != g]) for g in kept}
        dispensable = max(kept, key=lambda g: without[g])
        if promise(kept) - without[dispensable] >= least:
            break
        kept.remove(dispensable)
    return kept
