"""Where a fit stands: what was asked for, the best so far, what is left of its time, losses for its next part."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cmbrl.fitting.budget import Budget
from cmbrl.fitting.choice.trials import Incumbent
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.judge import Judge
from cmbrl.fitting.log.surveyed import Survey
from cmbrl.fitting.outcome.discrepancy import Discrepancy
from cmbrl.fitting.pace import ALLOWED, Pace, Plan, Speed
from cmbrl.fitting.search.folds import Folds, draw_starts
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.loss_values import Errors
from cmbrl.fitting.state import Journal, OutOfTime

GAUSS_NEWTON = "gauss-newton"
_HURRIED = 0.01  # of the usual work


@dataclass
class Standing:
    """What one fit was asked for and knows so far; its arguments are those of :func:`cmbrl.fit`, checked.

    ``wanted`` (n,): the parameters asked for; None: those that held-out errors call for. ``with_laws``: laws of
    friction may come besides. ``confirms``: delay and lag stay only where held-out errors call for them. ``count``: of
    folds, 0 for none.
    """

    evidence: Evidence
    budget: Budget
    journal: Journal
    seed: int
    huber: float
    count: int
    horizons: tuple[int, ...]
    method: str
    polish: bool
    wanted: np.ndarray | None
    with_laws: bool
    confirms: bool
    time_limit: float | None = None
    pace: Pace | None = field(init=False, default=None)  #: None before the first part
    incumbent: Incumbent = field(init=False)
    survey: Survey = field(init=False)
    sliding: dict[str, Any] | None = field(init=False, default=None)  #: how its law was chosen, if open
    finer: dict[str, Any] | None = field(init=False, default=None)  #: the time step, if the fit took a finer one
    stepping: list[dict[str, Any]] = field(init=False, default_factory=list)  #: what other settings of the model leave
    held_out: dict[str, Errors] = field(init=False, default_factory=dict)
    typical: float = field(init=False, default=1.0)  #: how many times smaller most of those errors are than the file's
    logs: list[dict[str, Any]] = field(init=False, default_factory=list)  #: how each of several agrees with the others

    def __post_init__(self) -> None:
        count = len(self.evidence.space)
        self.incumbent = Incumbent(np.zeros(count), np.zeros(count, dtype=bool))
        self.survey = Survey(min(self.horizons), None, {})  # until there is one

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Within, the part ``name`` of the work has the budget and the time that a time limit leaves it."""
        if self.pace is None:
            yield
            return
        incumbent, journal = self.incumbent, self.journal
        known = [self.survey.to_dict(), *(x.tolist() for x in (incumbent.z, incumbent.active, incumbent.begin))]
        self.budget = self.pace.begin(name, journal, known)
        with suppress(OutOfTime), journal.until(self.pace.end(name, journal.spent)):
            yield

    def hurry(self) -> None:
        """From here on, only as much work as tells anything: somebody waits."""
        self.budget = self.budget.shrunk(_HURRIED)

    def _set_pace(self) -> None:
        adds, searches = self.with_laws and self.count > 0, self.method != GAUSS_NEWTON
        plan = Plan.of(self.evidence, self.horizons, self.count, self.movable, self.wanted is None, adds, searches)
        limit = ALLOWED if self.time_limit is None else self.time_limit
        self.pace = Pace(self.budget, limit, self._speed(), plan, asked=self.time_limit is not None)

    def _speed(self) -> Speed:
        return Speed.of(self.evidence, min(self.horizons), self.huber, self.movable, self.seed)

    @property
    def _horizons(self) -> tuple[int, ...]:
        """Those that the survey tries."""
        return tuple(sorted(self.horizons)[: self.budget.horizons])

    def loss(self, limit: int, told: bool = False, steps: int | None = None) -> PredictionLoss:
        """At the horizon of the survey, or of ``steps``, over at most ``limit`` transitions.

        ``told``: in the units that the report tells errors in, the standard deviations of the change.
        """
        evidence, steps = self.evidence, steps or self.survey.horizon
        starts = draw_starts(evidence.log, steps, limit, self.seed, self.count)
        left = None if told else self.survey.left
        return evidence.loss(starts, steps, *evidence.scales(steps, self.huber, self.survey.noise, left))

    def discrepancy(self) -> Discrepancy:
        """What the model lacks, in parameters."""
        return Discrepancy(self.evidence, self.survey, self.huber, self.seed, self.budget.survey_rows, self.journal)

    @property
    def movable(self) -> np.ndarray:
        """The parameters (n,) that may be chosen, or were asked for."""
        return self.evidence.space.default if self.wanted is None else self.wanted

    def _trials(self, loss: PredictionLoss, folds: Folds, judges: list[list[Judge]]) -> tuple[Any, ...]:
        return self.evidence.space, loss, folds, judges, self.seed, self.budget, self.journal

    def _everything(self) -> tuple[PredictionLoss, Folds]:
        loss = self.loss(self.budget.trial_rows)
        return loss, self._folds(loss, loss)

    def _folds(self, train: PredictionLoss, judge: PredictionLoss) -> Folds:
        return Folds.of(train, judge, self.count, self.seed, self.budget.folds)
