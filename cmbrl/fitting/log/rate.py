"""Whether positions answer their commands as they would if rows were further apart, or nearer, than ``time`` says.

A log without velocities does not tell its rate by itself. But the file tells how fast drives and links answer, and a
rate that is wrong by a factor changes all of that at once: what gravity, inertia and gains do grows with different
powers of it. So the file predicts the log under other time steps. Where another one is clearly better, gains, damping,
friction and lateness are fitted under both: robots whose drives are not those of the file are explained under the step
that the log tells, and a wrong rate is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.sliding import rivals
from cmbrl.fitting.search.beginning import beginning, begins
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.fitting.search.gauss_newton import reweighed
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import NotFinite
from cmbrl.fitting.state import Journal
from cmbrl.models.between import AHEAD, DELAY, LAG
from cmbrl.models.windows import huber

_FACTORS = (0.1, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 10.0)  # by which rates are mistaken
_CLEARLY = 0.5  # of the loss at the log's own step
_SURELY = 0.33  # of the loss at the log's own step, after a fit of the drives at either step
_ROWS, _ITERATIONS, _PASSES = 1000, 12, 2
_ROUNDS, _FALLS = 5, 0.9  # of so many iterations; a loss that falls so far by one goes on
_DRIVES = ("kp", "kd", "kv", "damping", "frictionloss", "friction", AHEAD, DELAY, LAG)


@dataclass(frozen=True)
class RateCheck:
    """``evidence`` of positions, compared over ``horizon`` steps; ``huber`` and ``seed`` of the fit."""

    evidence: Evidence
    horizon: int
    huber: float
    seed: int

    def finding(self) -> Finding | None:
        """What is wrong with the rate; None where the log's own time step explains it about best."""
        own = min(self._loss_of_file(1.0), self._loss_of_other_laws())
        with np.errstate(all="ignore"):
            losses = {factor: self._loss_of_file(factor) for factor in _FACTORS}
        factor = min(losses, key=lambda f: losses[f] if np.isfinite(losses[f]) else np.inf)
        if not losses[factor] < _CLEARLY * min(own, self._loss_of_holding()):
            return None
        here, there = self._losses_of_drives(factor)
        if not there < here:
            return None
        dt, sure = self.evidence.log.dt, there < _SURELY * here
        what = (
            "no gains, damping or friction explain that: the" if sure else "gains and friction hardly explain that: a"
        )
        return Finding(
            f"time rises by {dt:.4g} s from row to row, but positions answer their commands as if it were "
            f"{factor * dt:.4g} s, and {what} wrong rate? Check the column time",
            sure,
        )

    def tell(self) -> None:
        """Raises UserError for a rate that is surely wrong, warns of a likely one."""
        if (found := self.finding()) is not None:
            found.tell()

    def _loss(self, factor: float) -> PredictionLoss:
        """Of predictions with rows ``factor`` times as far apart."""
        log = self.evidence.log
        model = self.evidence.model.with_settings(substeps=1, time_step=self.evidence.model.scene.timestep)
        stretched = replace(log, dt=log.dt * factor, v=log.v / factor, v_next=log.v_next / factor)
        evidence = replace(self.evidence, model=model.for_log(stretched.dt), log=stretched)
        starts = draw_starts(log, self.horizon, _ROWS, self.seed)
        return evidence.loss(starts, self.horizon, *evidence.scales(self.horizon, self.huber))

    def _loss_of_file(self, factor: float) -> float:
        loss = self._loss(factor)
        return float(loss.values(self.evidence.space.nominal[None])[0])

    def _loss_of_other_laws(self) -> float:
        """That of the file under MuJoCo's laws of contact, say, where those of the model may hold what moves."""
        others = [replace(self, evidence=replace(self.evidence, model=x)) for x in rivals(self.evidence).values()]
        return min((other._loss_of_file(1.0) for other in others), default=np.inf)

    def _loss_of_holding(self) -> float:
        """That of predicting that nothing moves, or all goes on as it does: what short time steps come near.

        Under them no force has time to act, whatever the robot does.
        """
        log, loss, difference = self.evidence.log, self._loss(1.0), self.evidence.model.scene.difference
        starts, scales = loss.windows.starts, loss.windows.scales
        rows, v = starts[:, None] + np.arange(self.horizon), log.v[starts][:, None]
        moved = -difference(log.q_next[rows], log.q[starts][:, None])
        held = log.dt * v * np.arange(1.0, self.horizon + 1.0)[:, None]
        off = [(moved - guess) / scales.q for guess in (0.0, held)]
        return min(float(huber(each, self.huber).sum(axis=-1).mean()) for each in off)

    def _losses_of_drives(self, factor: float) -> tuple[float, float]:
        """Of the log's own time step and of ``factor`` times that, with drives, damping and friction fitted.

        A stiff servo may be far from the file's. So the own one is fitted on while that helps and the other is better,
        and then the other as long.
        """
        own, other = self._fits_of_drives(1.0), self._fits_of_drives(factor)
        here, there, rounds = next(own), next(other), 1
        while there < here and rounds < _ROUNDS:
            before, here, rounds = here, next(own), rounds + 1
            if here > _FALLS * before:
                break
        return here, min([there, *islice(other, rounds - 1)]) if there < here else there

    def _fits_of_drives(self, factor: float) -> Iterator[float]:
        """The loss after ever more iterations; it never rises."""
        space, loss = self.evidence.space, self._loss(factor)
        missing = begins(space, space.default).any(axis=0)  # without a rotor, stiff servos shake links
        active, journal = np.isin(space.groups, _DRIVES) | missing, Journal(None, "")  # told gains may be wrong too
        z, best = beginning(loss, space, active, journal), np.inf
        while True:
            try:
                z = reweighed(loss, space, active, z, _ITERATIONS, journal, passes=_PASSES)
                best = min(best, float(loss.values(space.theta(z)[None])[0]))
            except NotFinite:
                pass
            yield best
