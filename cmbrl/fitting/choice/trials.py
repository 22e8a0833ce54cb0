"""Fits of some of the parameters, judged on episodes held out in turn: what every choice of parameters rests on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cmbrl.fitting.budget import Budget
from cmbrl.fitting.log.judge import Judge, score
from cmbrl.fitting.search.folds import LEAST_GAIN, NOISE_FACTOR, SOLVED, Folds, paired_gain
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.loss_values import Errors, NormalEquations
from cmbrl.fitting.search.objective import NotFinite, Objective
from cmbrl.fitting.search.random_search import random_search
from cmbrl.fitting.search.released import released
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.search.unseen import Unseen
from cmbrl.fitting.state import Journal

LEAST_SCORE = 0.03  # of the logarithm of the errors over all horizons
LEAST_STRAIN = 2.0  # of the logarithm of the prior: the other parameters may not go far to make up for one that stays
SHARE_OF_STRAIN = 0.05  # the same of hundreds of parameters, which go on moving where the log tells little


@dataclass
class Incumbent:
    """The best parameters so far, returned if the fit is interrupted, and how they were reached.

    ``active`` (n,): the parameters that may move, selected or asked for. ``begin`` (n,): where a fit of all of them
    begins (``beginning``). ``surveyed`` (n,): where a short one ended (``survey``). ``score``: the best of the path;
    ``course``: by search, its best objective by candidates; ``unseen``: held-out episodes with parameters fitted to the
    others. ``least``: the variance that weighs the prior at least, until unseen episodes call for a lesser weight.
    """

    z: np.ndarray
    active: np.ndarray
    path: list[dict[str, Any]] = field(default_factory=list)
    candidates: int = 0
    score: float = np.inf
    course: list[dict[str, Any]] = field(default_factory=list)
    unseen: Unseen | None = None
    surveyed: np.ndarray | None = None
    least: float = 0.0
    begin: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.begin = np.zeros_like(self.z)

    def put(self, z: np.ndarray, active: np.ndarray) -> None:
        """At ``z`` (n,), whence the ``active`` (n,) parameters may move."""
        self.z, self.active = z, active


@dataclass(frozen=True)
class Trial:
    """A fit with some groups more or less: its held-out ``errors``, the fall of the loss and the noise of that fall.

    ``noise_of_rise``: the noise if the loss were to rise by chance only. ``score``: the mean logarithm of the held-out
    errors at all horizons (``survey``). ``strain``: minus the logarithm of the prior, how far the parameters are from
    the file's: motion tells masses, gears and damping up to a common factor, so that some can make up for others.
    ``variance``: of the residuals that weighed the prior.
    """

    z: np.ndarray
    active: np.ndarray
    errors: Errors
    gain: float
    noise: float
    noise_of_rise: float
    score: float
    strain: float
    variance: float = 0.0

    def costs_nothing(self, loss: float, score: float, strain: float, groups: int = 1) -> bool:
        """Whether neither the held-out ``loss``, nor the ``score`` over all horizons, nor the ``strain`` rises.

        Each of the ``groups`` that are gone would have to be worth its share of the loss.
        """
        return (
            -self.gain <= max(NOISE_FACTOR * self.noise_of_rise, LEAST_GAIN * groups * loss, SOLVED)
            and self.score < score + LEAST_SCORE
            and self.strain < strain + max(LEAST_STRAIN, SHARE_OF_STRAIN * strain)
        )

    def counts(self, loss: float, share: float = LEAST_GAIN, factor: float = NOISE_FACTOR) -> bool:
        """Whether the fall of the held-out ``loss`` exceeds noise and accuracy and is worth a parameter."""
        return self.gain > max(factor * self.noise, share * loss, SOLVED)


@dataclass(frozen=True)
class Trials:
    """``loss`` is on all episodes; ``folds`` hold them out in turn; ``judges[k]`` predict what fold k holds out.

    ``holds``: fits without a fold weigh the prior as the fit of all does, not by the smaller errors that it leaves.
    """

    space: Space
    loss: PredictionLoss
    folds: Folds
    judges: list[list[Judge]]
    seed: int
    budget: Budget
    journal: Journal
    holds: bool = False

    def _trial(
        self,
        name: str,
        incumbent: Incumbent,
        active: np.ndarray,
        start: np.ndarray,
        searched: np.ndarray,
        before: Errors,
        iterations: int | None = None,
        least: float | None = None,
    ) -> Trial:
        """Fits ``active`` from ``start``: random search over the ``searched`` ones, then Gauss-Newton over all.

        Where motion explodes on the way, the trial stays at ``start``, with errors that are worse than all others.
        ``least``: the variance that weighs the prior at least; default: that of the incumbent.
        """
        budget, least = self.budget, incumbent.least if least is None else least

        def compute() -> dict[str, Any]:
            self.journal.check_time()
            try:
                z, folds, candidates, variance = fitted()
            except NotFinite:
                z, folds, candidates, variance = start, [start] * len(self.folds.train), 0, 0.0
            found = {"z": z.tolist(), "folds": [f.tolist() for f in folds]}
            return {**found, "candidates": candidates, "variance": variance}

        def fitted() -> tuple[np.ndarray, list[np.ndarray], int, float]:
            z, candidates, variance = start, 0, least
            if (active & searched).any():
                objective = Objective.at(self.loss, self.space, active & searched, z, least)
                found = random_search(
                    objective, z, self.seed, budget.trial_rounds, budget.trial_population, self.journal, name
                )
                z, candidates = found.z, found.candidates
            if active.any():
                objective = Objective.at(self.loss, self.space, active, z, least)
                found = gauss_newton(objective, z, iterations or budget.trial_iterations, self.journal)
                z, candidates, variance = found.z, candidates + found.candidates, objective.variance
            held = variance if self.holds else least
            folds, more = self.folds.refit(self.space, active, z, budget.trial_fold_iterations, self.journal, held)
            return z, folds, candidates + more, variance

        with np.errstate(all="ignore"):
            outcome = self.journal.unit(name, compute)
            incumbent.candidates += outcome["candidates"]
            z = np.array(outcome["z"])
            folds = [np.array(f) for f in outcome["folds"]]
            after = self.folds.errors(self.space, folds)
            gain, noise = paired_gain(before.loss, after.loss, self.folds.blocks())
            noise_of_rise = paired_gain(after.loss, before.loss, self.folds.blocks())[1]
            return Trial(
                z, active, after, gain, noise, noise_of_rise, self._score(folds), self._strain(z), outcome["variance"]
            )

    def _released(
        self, name: str, trial: Trial, incumbent: Incumbent, before: Errors, iterations: int, least: float | None = None
    ) -> Trial:
        """``trial``, or a better one from where joints that it has left on a bound are as the others of their kind."""
        start = released(self.space, trial.z, trial.active, incumbent.begin)
        if start is None:
            return trial
        self._tell(incumbent, "trying joints on a bound again")
        none = np.zeros_like(trial.active)
        again = self._trial(f"{name}, released", incumbent, trial.active, start, none, before, iterations, least)
        return again if again.gain > trial.gain else trial

    def _added(self, incumbent: Incumbent, groups: list[str], before: Errors) -> Trial:
        self._tell(incumbent, f"trying {', '.join(groups)}")
        columns = self.space.columns(groups)
        name = f"add {len(incumbent.path)} {' + '.join(groups)}"
        return self._trial(name, incumbent, incumbent.active | columns, incumbent.z, columns, before)

    def _tell(self, incumbent: Incumbent, text: str) -> None:
        """Reports what is being tried; the more steps lie behind, the nearer is the end of the choice."""
        self.journal.report(0.6 * (1.0 - 0.8 ** len(incumbent.path)), text)

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

    def _unmoved(self, incumbent: Incumbent) -> Errors:
        return self.folds.errors(self.space, [incumbent.z] * len(self.folds.train))

    def _equations(self, incumbent: Incumbent) -> NormalEquations:
        """Of the objective, whose prior holds what the log does not tell."""
        objective = Objective.at(self.loss, self.space, incumbent.active, incumbent.z)
        return objective.normal_equations(incumbent.z)

    def _strain(self, z: np.ndarray) -> float:
        return float(0.5 * z @ self.space.precision @ z)

    def _score(self, fitted: list[np.ndarray]) -> float:
        if not self.judges:
            return 0.0
        pairs = zip(self.judges, fitted, strict=True)
        return float(np.mean([score(judges, self.space.theta(z)) for judges, z in pairs]))
