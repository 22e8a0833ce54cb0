"""Open-loop errors of held-out episodes at several horizons: by which fits over different ones are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import LEAST_WINDOWS, judged_over
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.deviations import REST
from cmbrl.models.windows import huber, least_units, spread

_JUDGED, _JUDGED_ROWS = 500, 20_000  # windows at most, and predicted rows
RIGHT = 1e-4  #: loss of a coordinate (1 % of its change) below which it is right


@dataclass(frozen=True)
class Judge:
    """Errors ``horizon`` steps after the logged states at ``starts``, in the spread of the change over that time.

    Velocities that are estimates do not count.
    """

    evidence: Evidence
    starts: np.ndarray
    horizon: int
    scale: np.ndarray
    huber: float

    @classmethod
    def all(
        cls,
        evidence: Evidence,
        delta: float,
        rows: np.ndarray | None = None,
        horizons: Sequence[int] | None = None,
        share: float = 1.0,
    ) -> list[Judge]:
        """Judges of those ``horizons`` that the log has windows of, within held-out ``rows``; default: everywhere.

        Default: those that ``evidence`` is judged over. ``share``: of the most windows that a judge has.
        """
        found, data, scene = [], evidence.log, evidence.model.scene
        horizons = judged_over(evidence) if horizons is None else horizons
        for h in horizons:
            starts = data.windows(h)
            if len(starts) < LEAST_WINDOWS and h > min(horizons):
                continue
            ends = starts + h - 1
            dq = spread(scene.difference(data.q[starts], data.q_next[ends]), REST * data.dt * h)
            if evidence.positions_only:
                dq = np.where(evidence.measured, np.hypot(dq, least_units(scene, data)), np.inf)
            dv = spread(data.v_next[ends] - data.v[starts], REST)
            dv = np.where(evidence.positions_only | (evidence.sloped > 0), np.inf, dv)
            scale = np.where(np.tile(evidence.told, 2), np.concatenate([dq, dv]), np.inf)
            if rows is not None:
                starts = starts[np.isin(starts, rows) & np.isin(ends, rows)]
            if not len(starts):
                continue
            most = judged_rows(h, share) // h
            found.append(cls(evidence, starts[:: -(-len(starts) // most)], h, scale, delta))
        return found

    def error(self, theta: np.ndarray, model: ComplementarityModel | None = None) -> np.ndarray:
        """Mean Huber losses (2 nv,) with parameters ``theta`` (n,), by coordinate; or of another ``model`` as it is."""
        return self.loss(self.off(theta, model))

    def loss(self, off: np.ndarray) -> np.ndarray:
        """Mean Huber losses (2 nv,) of the errors ``off`` (s, 2 nv)."""
        return self.losses(off).mean(axis=0)

    def losses(self, off: np.ndarray) -> np.ndarray:
        """Huber losses (s, 2 nv) of the errors ``off`` (s, 2 nv)."""
        return huber(np.nan_to_num(off / self.scale, nan=1e6), self.huber)

    def off(self, theta: np.ndarray, model: ComplementarityModel | None = None) -> np.ndarray:
        """Predicted less logged states (s, 2 nv), as for ``error``."""
        rows = np.unique(self.starts[:, None] + np.arange(self.horizon))  # a long log has many more
        physical, log = self.evidence.seen(theta, rows)
        starts = np.searchsorted(rows, self.starts)
        if model is None:
            model = self.evidence.model
        else:
            physical = model.parameters
        q, v = log.q[starts], log.v[starts]
        observation, nq = self.evidence.observation, self.evidence.model.scene.nq
        own = observation.own_integral(observation.split(theta)[1], nq)
        for j in range(self.horizon):
            at = starts + j
            step = model.predict(q, v, own(log.u[at], q, log.q[at]), theta=physical)
            q, v = step.q_next, step.v_next
        return self._off(log, starts, q, v)

    def off_held(self) -> np.ndarray:
        """The same (s, 2 nv) of holding the velocity."""
        log = self.evidence.log
        q, v = log.q[self.starts], log.v[self.starts]
        return self._off(log, self.starts, self.evidence.model.scene.integrate(q, v * log.dt * self.horizon), v)

    def _off(self, log: Transitions, starts: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        ends = starts + self.horizon - 1
        return np.concatenate([self.evidence.model.scene.difference(log.q_next[ends], q), v - log.v_next[ends]], axis=1)


def judged_rows(horizon: int, share: float = 1.0) -> int:
    """Predicted rows of a judge with a ``share`` of the most windows that it may have."""
    return horizon * max(1, round(share * min(_JUDGED, _JUDGED_ROWS // horizon)))


def score(judges: Sequence[Judge], theta: np.ndarray) -> float:
    """Mean logarithm, over horizons and coordinates, of the losses with parameters ``theta`` (n,)."""
    errors = np.array([judge.error(theta)[np.isfinite(judge.scale)] for judge in judges])
    return float(np.mean(np.log(errors + RIGHT)))
