"""Whether positions answer their commands as they would if rows were further apart, or nearer, than ``time`` says.

A log without velocities does not tell its rate by itself. But the file tells how fast drives and links answer, and a
rate that is wrong by a factor changes all of that at once: what gravity, inertia and gains do grows with different
powers of it. So the file predicts the log under other time steps. Where another one is clearly better, gains, damping,
friction and lateness are fitted under both: robots whose drives are not those of the file are explained under the step
that the log tells, and a wrong rate is not.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.fitting.log.drives import ROWS, SURELY, compared, loss_of_file
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.holding import loss_of_holding
from cmbrl.fitting.log.sliding import rivals
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.state import Journal

_FACTORS = (0.1, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 10.0)  # by which rates are mistaken
_CLEARLY = 0.5  # of the loss at the log's own step


@dataclass(frozen=True)
class RateCheck:
    """``evidence`` of positions, compared over ``horizon`` steps; ``huber`` and ``seed`` of the fit."""

    evidence: Evidence
    horizon: int
    huber: float
    seed: int
    journal: Journal = field(default_factory=partial(Journal, None, ""))  #: which ends it when its time is up

    def finding(self) -> Finding | None:
        """What is wrong with the rate; None where the log's own time step explains it about best."""
        own = min(self._loss_of_file(1.0), self._loss_of_other_laws())
        losses = {factor: self._loss_of_file(factor) for factor in _FACTORS}
        factor = min(losses, key=lambda f: losses[f])
        # under short steps no force has time to act, whatever the robot does: they come near holding still
        if not losses[factor] < _CLEARLY * min(
            own, loss_of_holding(self.evidence, self._loss(1.0).windows, self.huber)
        ):
            return None
        here, there = compared(self._loss(1.0), self._loss(factor), self.evidence.space, self.journal)
        if not there < here:
            return None
        dt, sure = self.evidence.log.dt, there < SURELY * here
        what = (
            "no gains, damping or friction explain that: the" if sure else "gains and friction hardly explain that: a"
        )
        return Finding(
            f"time rises by {dt:.4g} s from row to row, but positions answer their commands as if it were "
            f"{factor * dt:.4g} s, and {what} wrong rate? Check the column time",
            sure,
        )

    def _loss(self, factor: float) -> PredictionLoss:
        """Of predictions with rows ``factor`` times as far apart."""
        self.journal.check_time()
        log = self.evidence.log
        model = self.evidence.model.with_settings(substeps=1, time_step=self.evidence.model.scene.timestep)
        stretched = replace(log, dt=log.dt * factor, v=log.v / factor, v_next=log.v_next / factor)
        evidence = replace(self.evidence, model=model.for_log(stretched.dt), log=stretched)
        starts = draw_starts(log, self.horizon, ROWS, self.seed)
        scales = self.evidence.scales(self.horizon, self.huber)  # of places, which rates do not change
        return evidence.loss(starts, self.horizon, *map(evidence.without_free, scales))

    def _loss_of_file(self, factor: float) -> float:
        return loss_of_file(self._loss(factor), self.evidence.space)

    def _loss_of_other_laws(self) -> float:
        """That of the file under MuJoCo's laws of contact, say, where those of the model may hold what moves."""
        others = [replace(self, evidence=replace(self.evidence, model=x)) for x in rivals(self.evidence).values()]
        return min((other._loss_of_file(1.0) for other in others), default=np.inf)
