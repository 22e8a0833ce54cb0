"""How far the parameters move when something changes that should not matter: what a wrong model makes of intervals.

A model that is right has the same best parameters over any horizon of the loss, and a finer time step does not move
them. One that is wrong does not: it fits each in its own way, and its residuals, which last and repeat, do not average
out over a longer log. No covariance of the scores shows this, because at the fit the scores cancel. So from the fitted
parameters, one Gauss-Newton step each tells where the fit would go

- over other horizons: the mean of dz dz^T over all of them;
- under other integrators and half the time step: half of that mean, each weighted by how well it explains the log
  next to the model itself (at most 1). What the log refutes does not count.

Both are added to the covariance. The half was chosen on draws of ``cmbrl bench coverage`` that it is not judged on.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cmbrl.errors import UserError
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import LEAST_WINDOWS, judged_over
from cmbrl.fitting.log.surveyed import Survey
from cmbrl.fitting.outcome.identify import inverse
from cmbrl.fitting.search.folds import draw_starts, windows_in_blocks
from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.state import Journal, OutOfTime
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.weighed import weighed_at

_STEPPING = 0.5  # share of the mean over other time steppings
_LEAST_VARIANCE = 1e-12  # of a normalised residual


@dataclass(frozen=True)
class Discrepancy:
    """Of a fit whose loss has the horizon and the noise of ``survey``; ``rows`` transitions for each step.

    When the time of the ``journal`` is up, those steps count that there are.
    """

    evidence: Evidence
    survey: Survey
    huber: float
    seed: int
    rows: int
    journal: Journal

    def covariance(self, z: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Covariance (n, n) in z of the ``active`` parameters at ``z``, zeros elsewhere.

        Raises LinAlgError where numbers overflow.
        """
        columns = np.flatnonzero(active)
        found = np.zeros((len(z), len(z)))
        if not len(columns):
            return found
        by_horizon: list[np.ndarray] = []
        by_stepping: list[np.ndarray] = []
        with suppress(OutOfTime):
            for h in self._horizons():
                by_horizon.append(self._step(z, columns, self._equations(z, active, h)))
                self.journal.check_time()
            own = self._equations(z, active, self.survey.horizon).variance
            for model in self.evidence.model.other_steppings():
                self.journal.check_time()
                equations = self._equations(z, active, self.survey.horizon, model)
                weight = min(1.0, max(own, _LEAST_VARIANCE) / max(equations.variance, _LEAST_VARIANCE))
                by_stepping.append(np.sqrt(weight) * self._step(z, columns, equations))
        total = _mean_square(by_horizon) + _STEPPING * _mean_square(by_stepping or [np.zeros(len(columns))])
        found[np.ix_(columns, columns)] = total
        return found

    def weighed(self, z: np.ndarray, active: np.ndarray) -> tuple[NormalEquations, np.ndarray] | None:
        """Equations at ``z`` under constant, exact inverse weights, and the step (n,) of the ``active`` to their fit.

        None where masses soften no row, the file cannot be written at ``z`` (``weights_told``), or time is up.
        """
        model, columns = self.evidence.model, np.flatnonzero(active)
        if not (model.scene.core.nweight and len(columns)):
            return None
        with suppress(UserError, OutOfTime):
            self.journal.check_time()
            scene = weighed_at(model.scene, self.evidence.observation.split(self.evidence.space.theta(z))[0])
            equations = self._equations(z, None, self.survey.horizon, model.with_settings(scene=scene))
            step = np.zeros(len(z))
            step[columns] = self._step(z, columns, equations)
            return equations, step
        return None

    def _horizons(self) -> list[int]:
        """Horizons that the log has windows of; of positions, those around the own one."""
        own = self.survey.horizon
        around = (max(1, own // 4), max(1, own // 2), own, 2 * own)
        tried = around if self.evidence.positions_only else (*judged_over(self.evidence), own)
        windows = {h: len(windows_in_blocks(self.evidence.log, h)) for h in sorted(set(tried))}
        return [h for h, count in windows.items() if count >= LEAST_WINDOWS or h == own]

    def _equations(
        self, z: np.ndarray, active: np.ndarray | None, horizon: int, model: ComplementarityModel | None = None
    ) -> NormalEquations:
        """At ``z`` in the columns ``active`` (n,); None: in all, with the root of their hessian."""
        evidence, theta = self.evidence, self.evidence.space.theta(z)
        starts = draw_starts(evidence.log, horizon, self.rows, self.seed)
        loss = evidence.loss(
            starts, horizon, *evidence.scales(horizon, self.huber, self.survey.noise, self.survey.left)
        )
        if model is not None:
            loss = replace(loss, model=model)
        return loss.settled(theta).normal_equations(evidence.space, z, active, rooted=active is None)

    def _step(self, z: np.ndarray, columns: np.ndarray, equations: NormalEquations) -> np.ndarray:
        """The Gauss-Newton step of the ``columns``, with the prior."""
        weight = equations.independent / max(equations.variance, _LEAST_VARIANCE)
        precision = self.evidence.space.precision
        hessian = weight * equations.hessian[np.ix_(columns, columns)] + precision[np.ix_(columns, columns)]
        step: np.ndarray = inverse(hessian) @ (-weight * equations.gradient[columns] - (precision @ z)[columns])
        return step


def _mean_square(steps: list[np.ndarray]) -> np.ndarray:
    rows = np.stack(steps)
    return rows.T @ rows / len(rows)
