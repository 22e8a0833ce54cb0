"""Sensor noise of a log, estimated from what a model leaves unexplained.

With noise e on every state, the one-step residual is r_k = A e_k - e_(k+1) + model error. The same e_(k+1) enters r_k
and r_(k+1) with opposite signs, so noise shows as a *negative* covariance of neighbouring residuals, -A R, with A near
the identity. Model errors last or are independent, and do not look like this. Velocities that a contact stops keep no
noise (A = 0 there); nothing is missed, because such noise does not reach the next states either. The covariance comes
from median absolute deviations of sums and differences, so impacts do not count.

Errors of a capture that last over several steps, or velocities that were filtered, are not found: their neighbours
agree, like those of a wrong model.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.evidence import Evidence
from cmbrl.models.complementarity import ComplementarityModel

_CLEAR = 0.15  # share of the variance that must be negative correlation; noise alone has 0.5, clean logs at most 0.11
_SURE = 3.0  # and in standard errors of a correlation
_ROWS = 5000
_TO_DEVIATION = 1.4826  # of a normal distribution, from its median absolute deviation


def sensor_noise(evidence: Evidence, theta: np.ndarray) -> np.ndarray | None:
    """Standard deviations (logs, 2 nv) of the noise of q and v, zero where none shows; None if none shows anywhere."""
    physical, data = evidence.seen(theta)
    rows = data.windows(2)
    of = data.recording[rows]
    found = np.stack([_of_rows(evidence, physical, data, rows[of == k]) for k in range(len(evidence.names))])
    return found if found.any() else None


def _of_rows(evidence: Evidence, physical: np.ndarray, data: Transitions, rows: np.ndarray) -> np.ndarray:
    """Standard deviations (2 nv,) from transitions at ``rows`` (N,) and those after them."""
    rows = rows[:: max(1, len(rows) // _ROWS)]
    if len(rows) < 2:
        return np.zeros(2 * evidence.model.scene.nv)
    first, second = (_residual(evidence.model, physical, data, r) for r in (rows, rows + 1))
    apart, together = _spread(first - second), _spread(first + second)
    shared, whole = (apart**2 - together**2) / 4.0, (apart**2 + together**2) / 4.0
    found = shared > max(_CLEAR, _SURE / np.sqrt(len(rows))) * whole
    return np.sqrt(np.where(found, shared, 0.0))


def _residual(model: ComplementarityModel, theta: np.ndarray, data: Transitions, rows: np.ndarray) -> np.ndarray:
    step = model.predict(data.q[rows], data.v[rows], data.u[rows], theta=theta)
    dq = model.scene.difference(data.q_next[rows], step.q_next)
    return np.nan_to_num(np.concatenate([dq, step.v_next - data.v_next[rows]], axis=1))


def _spread(x: np.ndarray) -> np.ndarray:
    return _TO_DEVIATION * np.median(np.abs(x - np.median(x, axis=0)), axis=0)
