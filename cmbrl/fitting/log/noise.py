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
agree, like those of a wrong model. But velocities that are slopes of the log's own positions, over a few rows before
and after (Savitzky and Golay, 1964), have what these leave of the positions' noise.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.position_noise import covariance, of_positions, of_slopes, some_of, spread
from cmbrl.models.complementarity import ComplementarityModel

_CLEAR = 0.15  # share of the variance that must be negative correlation; noise alone has 0.5, clean logs at most 0.11
_FOLLOWS = 0.5  # of the variance of what alternates: sensors leave at most .2, late commands at least .5
_ANSWERS = 0.2  # of the variance of a residual, which the command after it explains besides
_OUTLIER = 4.0  # standard deviations
_SURE = 3.0  # and in standard errors of a correlation
_TINY = 1e-300


def sensor_noise(evidence: Evidence, theta: np.ndarray, most: int = 5000) -> np.ndarray | None:
    """Standard deviations (logs, 2 nv) of the noise of q and v, zero where none shows; None if none shows anywhere.

    Of about ``most`` rows of each log, if it has more.
    """
    physical, data = evidence.seen(theta)
    rows = data.windows(3) + 1
    of = data.recording[rows]
    by_log = [some_of(rows[of == k], most) for k in range(len(evidence.names))]
    found = np.stack([_of_rows(evidence, physical, data, some) for some in by_log])
    return found if found.any() else None


def _of_rows(evidence: Evidence, physical: np.ndarray, data: Transitions, rows: np.ndarray) -> np.ndarray:
    """Standard deviations (2 nv,) from transitions at ``rows`` (N,) and those before and after them."""
    nv = evidence.model.scene.nv
    if len(rows) < 2:
        return np.zeros(2 * nv)
    first, second = (_residual(evidence.model, physical, data, r) for r in (rows, rows + 1))
    own = of_positions(evidence.model.scene, data, rows)
    own = np.where(own < spread(first[:, :nv]), own, 0.0)
    past, all_three = (np.concatenate([data.u[rows + k] for k in range(-1, last)], axis=1) for last in (1, 2))
    late = _explained(first - second, all_three) >= _FOLLOWS
    late &= _explained(first, all_three) - _explained(first, past) < _ANSWERS
    found = np.where(late, 0.0, _alternating(first, second))
    found[:nv] = np.where(own > 0.0, own, found[:nv])
    found[nv:] = np.where(evidence.sloped > 0, of_slopes(evidence.sloped, found[:nv], data.dt), found[nv:])
    return np.where(np.tile(evidence.told, 2), found, 0.0)


def _alternating(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Deviations (c,) of the noise whose differences neighbours (N, c) share, 0 where none shows."""
    shared, whole = covariance(first, second)
    return np.sqrt(np.where(shared > max(_CLEAR, _SURE / np.sqrt(len(first))) * whole, shared, 0.0))


def _explained(x: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """The share (c,) of the variance of ``x`` (N, c), without its outliers, that is linear in ``commands`` (N, m)."""
    limit = _OUTLIER * spread(x)
    centred = np.clip(x - np.median(x, axis=0), -limit, limit)
    told = np.column_stack([np.ones(len(x)), commands])
    free = len(x) - np.linalg.matrix_rank(told)
    if free < 1:
        return np.zeros(x.shape[1])
    left = centred - told @ np.linalg.lstsq(told, centred, rcond=None)[0]
    return np.asarray(1.0 - (left**2).sum(axis=0) / free / np.maximum(centred.var(axis=0), _TINY))


def _residual(model: ComplementarityModel, theta: np.ndarray, data: Transitions, rows: np.ndarray) -> np.ndarray:
    step = model.predict(data.q[rows], data.v[rows], data.u[rows], theta=theta)
    dq = model.scene.difference(data.q_next[rows], step.q_next)
    return np.nan_to_num(np.concatenate([dq, step.v_next - data.v_next[rows]], axis=1))
