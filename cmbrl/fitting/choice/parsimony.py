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
later ones made superfluous are removed, in the order of the forecast, until ``TRIED`` in a row prove to be needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from cmbrl.fitting.choice.forecast import Forecast, adjusted, rise, superfluous
from cmbrl.fitting.choice.trials import Incumbent, Trial, Trials
from cmbrl.fitting.log.judge import RIGHT
from cmbrl.fitting.search.folds import LEAST_GAIN, NOISE_FACTOR, SOLVED, paired_gain
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss_values import Errors, NormalEquations
from cmbrl.fitting.search.objective import Objective

CLEAR_RISE = 0.1  # of the loss, by the forecast: a group whose removal costs so much is not tried
CLEARLY_WORSE = 0.1  # of the loss: a group without which the first held-out episodes lose so much stays
ALL = "all that a fit moves by default"  #: in the path of a selection
TRIED = 3  # groups per round: forecasts are accurate enough for the best to be among the first
_STIRS = (-2.0, -0.5, 0.5, 2.0)  # prior standard deviations


class Selection(Trials):
    """Forward selection, then elimination."""

    def run(self, incumbent: Incumbent) -> None:
        """Adds groups to ``incumbent`` and removes superfluous ones; raises the journal's OutOfTime between trials."""
        before = self._unmoved(incumbent)
        before = self._thin(incumbent, self._everything(incumbent, before))
        while (after := self._add(incumbent, before)) is not None:
            before = after
        self._remove(incumbent, before)

    def _everything(self, incumbent: Incumbent, before: Errors) -> Errors:
        """Starts from all groups if that beats the nominal model, and returns the new errors."""
        groups = self._remaining(incumbent)
        self.journal.report(0.05, "trying all parameters")
        everything, none = self.space.columns(groups), np.zeros_like(incumbent.active)
        iterations, known = self.budget.polish_iterations, incumbent.surveyed
        trial = self._trial("add all", incumbent, everything, incumbent.begin, none, before, iterations)
        if known is not None and self._explains_more(known, trial.z):  # contacts that come and go stopped it halfway
            again = self._trial("add all again", incumbent, everything, known, none, before, iterations)
            trial = max(trial, again, key=lambda t: t.gain)
        trial = self._released("add all", trial, incumbent, before, iterations)
        return self._accept("add", ALL, trial, incumbent) if trial.counts(before.mean) else before

    def _explains_more(self, one: np.ndarray, other: np.ndarray) -> bool:
        """Whether the loss at ``one`` (n,) is clearly below that at the ``other``."""
        errors = [self.loss.errors(self.space.theta(z)).mean for z in (one, other)]
        return errors[0] < (1.0 - LEAST_GAIN) * errors[1]

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
        least = max(LEAST_GAIN * before.mean, SOLVED)
        dispensable = superfluous(self.space, incumbent.z, incumbent.active, equations, groups, least)
        kept = self._kept(incumbent, before) if dispensable else None
        while dispensable and kept is not None:
            columns = self.space.columns(dispensable)
            start, none = self._start(incumbent, columns, equations), np.zeros_like(columns)
            self.journal.report(0.2, f"removing {', '.join(dispensable)}")
            name = f"remove {len(incumbent.path)} {' + '.join(dispensable)}"
            trial = self._trial(name, incumbent, incumbent.active & ~columns, start, none, kept.errors)
            if trial.costs_nothing(kept.errors.mean, incumbent.score, kept.strain, len(dispensable)):
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
        if before.mean <= SOLVED:
            return None
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
            trial = self._added(incumbent, [group], before)
            if trial.counts(before.mean) and (winner is None or trial.gain > winner[1].gain):
                winner = group, trial
        if winner is None and len(together := _needed(ranked, promise, LEAST_GAIN * before.mean)) > 1:
            trial = self._added(incumbent, together, before)
            winner = (" + ".join(together), trial) if trial.counts(before.mean) else None
        for group in blank if winner is None else ():
            if self._idle(incumbent.z, self.space.columns([group])):
                continue
            trial = self._added(incumbent, [group], before)
            if trial.counts(before.mean):
                winner = group, trial
                break
        return None if winner is None else self._accept("add", *winner, incumbent)

    def _remaining(self, incumbent: Incumbent) -> list[str]:
        groups = dict.fromkeys(g for g, told in zip(self.space.groups, self.space.default, strict=True) if told)
        return [g for g in groups if not incumbent.active[self.space.columns([g])].any()]

    def _remove(self, incumbent: Incumbent, before: Errors) -> None:
        """Removes groups one by one, those first whose loss the forecast says is small, until several in a row stay."""
        tried: set[str] = set()
        failures, equations, kept = 0, None, None
        while failures < TRIED and (groups := [g for g in self._active(incumbent) if g not in tried]):
            if equations is None or kept is None:
                equations, kept = self._equations(incumbent), self._kept(incumbent, before)
            costs = {g: rise(incumbent.z, incumbent.active, self.space.columns([g]), equations) for g in groups}
            group = min(groups, key=lambda g: costs[g])
            if costs[group] > CLEAR_RISE * max(kept.errors.mean, RIGHT):  # below, the quadratic errs by more
                return
            tried.add(group)
            trial = self._without(incumbent, group, equations, kept)
            if trial is None:
                failures += 1
                continue
            before = self._accept("remove", group, trial, incumbent)
            failures, equations, kept = 0, None, None

    def _without(self, incumbent: Incumbent, group: str, equations: NormalEquations, kept: Trial) -> Trial | None:
        """A fit without ``group``; None if it is worse."""
        columns = self.space.columns([group])
        self.journal.report(0.6, f"removing {group}")
        start, active = self._start(incumbent, columns, equations), incumbent.active & ~columns
        name = f"remove {len(incumbent.path)} {group}"
        if self._needed_at_once(f"screen {name}", active, start, kept.errors):
            return None
        trial = self._trial(name, incumbent, active, start, np.zeros_like(columns), kept.errors)
        return trial if trial.costs_nothing(kept.errors.mean, incumbent.score, kept.strain) else None

    def _kept(self, incumbent: Incumbent, before: Errors) -> Trial:
        """The same fit with as many iterations more as one without a group gets, to be compared with."""
        active, z = incumbent.active, incumbent.z
        return self._trial(f"keep {len(incumbent.path)}", incumbent, active, z, np.zeros_like(active), before)

    def _start(self, incumbent: Incumbent, gone: np.ndarray, equations: NormalEquations) -> np.ndarray:
        """Where a fit without the parameters that are ``gone`` (n,) begins, inside the bounds."""
        z = adjusted(incumbent.z, incumbent.active, gone, equations)
        return np.where(gone, 0.0, np.clip(z, self.space.z_low, self.space.z_high))

    def _needed_at_once(self, name: str, active: np.ndarray, start: np.ndarray, before: Errors) -> bool:
        """Whether the first held-out episodes alone are predicted clearly worse by a short fit of ``active``."""

        def compute() -> dict[str, Any]:
            self.journal.check_time()
            objective = Objective.at(self.folds.train[0], self.space, active, start)
            found = gauss_newton(objective, start, self.budget.screen_iterations, self.journal)
            after = self.folds.held_out[0].errors(self.space.theta(found.z))
            own = before.loss[: len(after.loss)]
            noise = paired_gain(after.loss, own, self.folds.blocks()[: len(own)])[1]
            rises = float(after.mean - own.mean())
            return {"needed": bool(rises > max(CLEARLY_WORSE * max(before.mean, RIGHT), 2.0 * NOISE_FACTOR * noise))}

        return bool(self.journal.unit(name, compute)["needed"])

    def _active(self, incumbent: Incumbent) -> list[str]:
        return [g for g in dict.fromkeys(self.space.groups) if incumbent.active[self.space.columns([g])].any()]


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
