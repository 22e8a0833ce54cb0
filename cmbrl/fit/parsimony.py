"""No more parameters than the data ask for: selection by parameter group, judged on episodes held out in turn.

From the nominal model, each group that is not in yet is tried: a short search over its parameters, then Gauss-Newton
over all that are in. The best group stays when the held-out loss falls by more than ``NOISE_FACTOR`` times its noise
(see ``folds.paired_gain``; two rather than one, since the best of a dozen trials is looked at) and by at least
``LEAST_GAIN`` of the loss, since a log without noise makes any gain significant. At the end, groups that later ones
have made superfluous (out, they cost less than that) are taken out again.

Trials are ordered by what each group gained last time and stop as soon as no other group promises more (Minoux,
"Accelerated greedy algorithms", 1978); the selection ends only when every remaining group has failed on the present
model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cmbrl.fit.folds import Folds, paired_gain
from cmbrl.fit.gauss_newton import gauss_newton
from cmbrl.fit.loss import Errors, PredictionLoss
from cmbrl.fit.objective import Objective
from cmbrl.fit.random_search import random_search
from cmbrl.fit.space import Space
from cmbrl.fit.state import Journal

NOISE_FACTOR = 2.0
LEAST_GAIN = 0.01


@dataclass
class Incumbent:
    """The best parameters so far, and how they were reached: what an interrupted fit falls back on.

    ``chosen`` (n,): parameters whose group was selected or asked for; ``active``: those of them that may move (not
    the gauge). ``before_refit``: where z was when the held-out episodes had not been seen yet, once they are.
    """

    z: np.ndarray
    chosen: np.ndarray
    active: np.ndarray
    path: list[dict[str, Any]] = field(default_factory=list)
    candidates: int = 0


@dataclass(frozen=True)
class Trial:
    """The fit with one group more or less: its held-out ``errors``, by how much the loss fell and the noise of that."""

    z: np.ndarray
    chosen: np.ndarray
    active: np.ndarray
    errors: Errors
    gain: float
    noise: float

    def counts(self, loss: float) -> bool:
        """Whether the fall of a held-out ``loss`` is more than noise, and worth a parameter."""
        return self.gain > max(NOISE_FACTOR * self.noise, LEAST_GAIN * loss)


@dataclass(frozen=True)
class Selection:
    """Forward selection, then elimination; ``loss`` is on all episodes, ``folds`` hold them out in turn.

    ``admit(chosen, z)`` takes the columns that carry no information of their own (gauge) out of ``chosen``; returns
    both.
    """

    space: Space
    loss: PredictionLoss
    folds: Folds
    admit: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    seed: int
    rounds: int
    population: int
    iterations: int
    fold_iterations: int
    journal: Journal

    def run(self, incumbent: Incumbent) -> None:
        """Adds groups to ``incumbent``, takes superfluous ones out; raises OutOfTime of the journal between trials."""
        nominal = self.folds.errors(self.space, [incumbent.z] * len(self.folds.train))
        self._remove(incumbent, self._add(incumbent, nominal))

    def _add(self, incumbent: Incumbent, before: Errors) -> Errors:
        groups = list(dict.fromkeys(self.space.groups))
        promise = dict.fromkeys(groups, np.inf)
        while True:
            tried: dict[str, Trial] = {}
            winner: str | None = None
            remaining = [g for g in groups if not incumbent.chosen[self.space.columns([g])].any()]
            for group in sorted(remaining, key=lambda g: (-promise[g], groups.index(g))):
                if winner is not None and tried[winner].gain >= promise[group]:
                    break
                done = 1.0 - 0.7 ** (len(incumbent.path) + len(tried) / len(groups))
                self.journal.report(0.6 * done, f"trying {group}")
                columns = self.space.columns([group])
                name = f"add {len(incumbent.path)} {group}"
                trial = self._trial(name, incumbent, incumbent.chosen | columns, incumbent.z, columns, before)
                tried[group], promise[group] = trial, trial.gain
                if trial.counts(before.mean) and (winner is None or trial.gain > tried[winner].gain):
                    winner = group
            if winner is None:
                return before
            before = self._accept("add", winner, tried[winner], incumbent)

    def _remove(self, incumbent: Incumbent, before: Errors) -> None:
        for group in [step["group"] for step in incumbent.path[:-1]]:  # the last one has just proved its worth
            self.journal.report(0.6, f"leaving out {group}")
            columns = self.space.columns([group])
            start = np.where(columns, 0.0, incumbent.z)
            name = f"remove {len(incumbent.path)} {group}"
            none = np.zeros_like(columns)
            trial = self._trial(name, incumbent, incumbent.chosen & ~columns, start, none, before)
            if trial.gain > -LEAST_GAIN * before.mean:
                before = self._accept("remove", group, trial, incumbent)

    def _accept(self, move: str, group: str, trial: Trial, incumbent: Incumbent) -> Errors:
        incumbent.z, incumbent.chosen, incumbent.active = trial.z, trial.chosen, trial.active
        incumbent.path.append(
            {
                "move": move,
                "group": group,
                "gain": trial.gain,
                "noise": trial.noise,
                "held_out_loss": trial.errors.mean,
                "held_out_rmse": trial.errors.rmse,
            }
        )
        return trial.errors

    def _trial(
        self,
        name: str,
        incumbent: Incumbent,
        chosen: np.ndarray,
        start: np.ndarray,
        searched: np.ndarray,
        before: Errors,
    ) -> Trial:
        """Fits ``chosen`` from ``start``: random search over the ``searched`` among them, Gauss-Newton over all."""
        active, start = self.admit(chosen, start)

        def compute() -> dict[str, Any]:
            self.journal.check_time()
            z, candidates = start, 0
            if (active & searched).any():
                objective = Objective.at(self.loss, self.space, active & searched, z)
                found = random_search(objective, z, self.seed, self.rounds, self.population, self.journal, name)
                z, candidates = found.z, found.candidates
            if active.any():
                objective = Objective.at(self.loss, self.space, active, z)
                found = gauss_newton(objective, z, self.iterations, self.journal)
                z, candidates = found.z, candidates + found.candidates
            fitted, more = self.folds.refit(self.space, active, z, self.fold_iterations, self.journal)
            return {"z": z.tolist(), "folds": [f.tolist() for f in fitted], "candidates": candidates + more}

        outcome = self.journal.unit(name, compute)
        incumbent.candidates += outcome["candidates"]
        z = np.array(outcome["z"])
        after = self.folds.errors(self.space, [np.array(f) for f in outcome["folds"]])
        gain, noise = paired_gain(before.loss, after.loss, self.folds.blocks())
        return Trial(z, chosen, active, after, gain, noise)
