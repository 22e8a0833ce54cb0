"""Sensor noise of a log, estimated from its own positions and velocities and from what a model leaves unexplained.

Positions change by the integral of the velocities. What is left of that, x_k = q_(k+1) - q_k - dt v, needs no model:
noise e of the positions makes e_(k+1) - e_k of it, so neighbours x_k and x_(k+1) have the covariance -R. The mean
velocity v is that of both ends. Where the velocity at the end alone leaves less, an Euler step made the log or the
velocities are differences of the positions, and x_k tells nothing. Velocities that turn within a row leave x_k that
alternates as well: noise has to be more than the next term of the quadrature, dt (v_(k+2) - 2 v_(k+1) + v_k) / 12, and
no more than a model leaves. Slides of one body, and its turns, are measured alike: they share what they tell.

Velocities, and positions of which x_k tells nothing, need the model. With noise e on every state, the one-step residual
is r_k = A e_k - e_(k+1) + model error. The same e_(k+1) enters r_k and r_(k+1) with opposite signs, so noise shows as a
*negative* covariance of neighbouring residuals, -A R, with A near the identity. Model errors last or are independent,
and do not look like this. Velocities that a contact stops keep no noise (A = 0 there); nothing is missed, because such
noise does not reach the next states either. A position that a contact pushes back does reach them, though A is not the
identity there; hence x_k. Commands that come late alternate too where each differs from the last one: what follows the
commands is the model's error. But a controller answers to what it measured: where r_k goes with the command after it,
that has followed the noise. Covariances come from median absolute deviations of sums and differences, so impacts do
not count.

Errors of a capture that last over several steps, or velocities that were filtered, are not found: their neighbours
agree, like those of a wrong model.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import JointKind

_CLEAR = 0.15  # share of the variance that must be negative correlation; noise alone has 0.5, clean logs at most 0.11
_CLEAR_OF_POSITIONS = 0.1  # clean logs have less than nothing, but for chatter
_TURNING = 1.6  # times the next term: logs without noise reach 1.3
_FOLLOWS = 0.5  # of the variance of what alternates: sensors leave at most .2, late commands at least .5
_ANSWERS = 0.2  # of the variance of a residual, which the command after it explains besides
_OUTLIER = 4.0  # standard deviations
_SURE = 3.0  # and in standard errors of a correlation
_TINY = 1e-300
_TO_DEVIATION = 1.4826  # of a normal distribution, from its median absolute deviation


def sensor_noise(evidence: Evidence, theta: np.ndarray, most: int = 5000) -> np.ndarray | None:
    """Standard deviations (logs, 2 nv) of the noise of q and v, zero where none shows; None if none shows anywhere.

    Of about ``most`` rows of each log, if it has more.
    """
    physical, data = evidence.seen(theta)
    rows = data.windows(3) + 1
    of = data.recording[rows]
    by_log = [_some(rows[of == k], most) for k in range(len(evidence.names))]
    found = np.stack([_of_rows(evidence, physical, data, some) for some in by_log])
    return found if found.any() else None


def _of_rows(evidence: Evidence, physical: np.ndarray, data: Transitions, rows: np.ndarray) -> np.ndarray:
    """Standard deviations (2 nv,) from transitions at ``rows`` (N,) and those before and after them."""
    nv = evidence.model.scene.nv
    if len(rows) < 2:
        return np.zeros(2 * nv)
    first, second = (_residual(evidence.model, physical, data, r) for r in (rows, rows + 1))
    own = _of_positions(evidence.model.scene, data, rows)
    own = np.where(own < _spread(first[:, :nv]), own, 0.0)
    past, all_three = (np.concatenate([data.u[rows + k] for k in range(-1, last)], axis=1) for last in (1, 2))
    late = _explained(first - second, all_three) >= _FOLLOWS
    late &= _explained(first, all_three) - _explained(first, past) < _ANSWERS
    found = np.where(late, 0.0, _alternating(first, second))
    found[:nv] = np.where(own > 0.0, own, found[:nv])
    return np.where(np.tile(evidence.told, 2), found, 0.0)


def _some(rows: np.ndarray, most: int) -> np.ndarray:
    return rows[:: max(1, len(rows) // most)]


def _of_positions(scene: Scene, data: Transitions, rows: np.ndarray) -> np.ndarray:
    """Standard deviations (nv,) of the noise of q, by what the velocities of the log leave of its changes."""

    def left(at: np.ndarray, end: float) -> np.ndarray:
        mean = (1.0 - end) * data.v[at] + end * data.v_next[at]
        return scene.difference(data.q[at], data.q_next[at]) - data.dt * mean

    (shared, whole), (_, of_end) = (_covariance(left(rows, end), left(rows + 1, end)) for end in (0.5, 1.0))
    next_term = data.dt / 12.0 * _spread(data.v[rows] - 2.0 * data.v_next[rows] + data.v_next[rows + 1])
    alike = _measured_alike(scene)
    mean = alike / alike.sum(axis=1, keepdims=True)
    clear = mean @ (shared / np.maximum(whole, _TINY)) > np.maximum(
        _CLEAR_OF_POSITIONS, _SURE / np.sqrt(len(rows) * alike.sum(axis=1))
    )
    clear &= (whole < of_end) & (mean @ shared > mean @ (_TURNING * next_term) ** 2)
    return np.sqrt(np.where(clear, np.maximum(mean @ shared, 0.0), 0.0))


def _measured_alike(scene: Scene) -> np.ndarray:
    """(nv, nv): 1 for coordinates of one body that are both slides or both turns, else 0."""
    core = scene.core
    kind = 2 * core.jnt_body + (core.jnt_type == JointKind.SLIDE)
    of_dof = kind[np.searchsorted(core.jnt_vadr, np.arange(core.nv), side="right") - 1]
    return (of_dof[:, None] == of_dof).astype(float)


def _alternating(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Deviations (c,) of the noise whose differences neighbours (N, c) share, 0 where none shows."""
    shared, whole = _covariance(first, second)
    return np.sqrt(np.where(shared > max(_CLEAR, _SURE / np.sqrt(len(first))) * whole, shared, 0.0))


def _explained(x: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """The share (c,) of the variance of ``x`` (N, c), without its outliers, that is linear in ``commands`` (N, m)."""
    limit = _OUTLIER * _spread(x)
    centred = np.clip(x - np.median(x, axis=0), -limit, limit)
    told = np.column_stack([np.ones(len(x)), commands])
    free = len(x) - np.linalg.matrix_rank(told)
    if free < 1:
        return np.zeros(x.shape[1])
    left = centred - told @ np.linalg.lstsq(told, centred, rcond=None)[0]
    return np.asarray(1.0 - (left**2).sum(axis=0) / free / np.maximum(centred.var(axis=0), _TINY))


def _covariance(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What neighbours (N, c) have less than nothing in common, and the variances of one: (c,) both."""
    apart, together = _spread(first - second), _spread(first + second)
    return (apart**2 - together**2) / 4.0, (apart**2 + together**2) / 4.0


def _residual(model: ComplementarityModel, theta: np.ndarray, data: Transitions, rows: np.ndarray) -> np.ndarray:
    step = model.predict(data.q[rows], data.v[rows], data.u[rows], theta=theta)
    dq = model.scene.difference(data.q_next[rows], step.q_next)
    return np.nan_to_num(np.concatenate([dq, step.v_next - data.v_next[rows]], axis=1))


def _spread(x: np.ndarray) -> np.ndarray:
    return _TO_DEVIATION * np.median(np.abs(x - np.median(x, axis=0)), axis=0)
