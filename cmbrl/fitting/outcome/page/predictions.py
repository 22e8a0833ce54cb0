"""Predictions of unseen rows, each by parameters that were fitted without it: one step, and open loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.fitting.search.unseen import Unseen
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import blocks_of
from cmbrl.scene.records import JointKind

MOST_ROWS = 6000  #: of one-step predictions
_SHORTEST = 0.25  # [s] of a window that is drawn, unless the fit's are longer
_WINDOWS = 6  # drawn, at least
_SECONDS = 2.0  # drawn, at least


@dataclass(frozen=True)
class OneStep:
    """Of held-out rows (n,): what the velocity changes by beyond what the model says, per second, and where.

    ``before`` and ``after`` (n, nv), of the nominal and the fitted model [m/s^2, rad/s^2]; ``command`` (n, nv), NaN
    where no actuator drives a coordinate alone; ``speed`` and ``position`` (n, nv); ``gap`` (n,) [m] to the nearest
    contact; ``spread`` (nv,), the standard deviation of the logged change of velocity per second.
    """

    before: np.ndarray
    after: np.ndarray
    command: np.ndarray
    speed: np.ndarray
    position: np.ndarray
    gap: np.ndarray
    spread: np.ndarray


@dataclass(frozen=True)
class Window:
    """``logged``, and predicted ``before`` and ``after`` the fit (steps + 1, nv), of one window predicted open loop."""

    logged: np.ndarray
    before: np.ndarray
    after: np.ndarray


def one_step(model: ComplementarityModel, unseen: Unseen) -> OneStep:
    """Of at most MOST_ROWS held-out rows, evenly spread."""
    log, scene = unseen.log, model.scene
    parts = []
    for rows, theta in zip(_thinned(unseen), unseen.theta, strict=True):
        errors = []
        for values in (unseen.nominal, theta):
            physical, psi = unseen.observation.split(values)
            seen = unseen.observation.states(log, psi, rows)
            step = model.predict(seen.q, seen.v, seen.u, theta=physical)
            errors.append((log.v_next[rows] - step.v_next) / log.dt)
        command = np.full((len(rows), scene.nv), np.nan)
        for dof in range(scene.nv):
            actuators = np.flatnonzero(scene.core.act_line == dof)
            if len(actuators) == 1:
                command[:, dof] = seen.u[:, actuators[0]]
        q = seen.q
        gap = scene.gaps(q).min(axis=-1, initial=np.inf)
        parts.append((*errors, command, log.v[rows], coordinates(model, q), gap))
    rows = np.concatenate(_thinned(unseen))
    before, after, command, speed, position, gap = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    spread = np.maximum(((log.v_next - log.v)[rows] / log.dt).std(axis=0), 1e-12)
    return OneStep(before, after, command, speed, position, gap, spread)


def windows(model: ComplementarityModel, unseen: Unseen, found: OneStep) -> tuple[Window, ...]:
    """Windows one after another, from the held-out episodes (or blocks) whose errors are nearest to the median."""
    log = unseen.log
    length = max(unseen.horizon, round(_SHORTEST / log.dt))
    chosen: list[tuple[int, int, np.ndarray]] = []
    for rows, theta in _by_error(unseen, found):
        for first, steps in _cut(rows, length):
            chosen.append((first, steps, theta))
        drawn = sum(steps for _, steps, _ in chosen)
        if len(chosen) >= _WINDOWS and drawn * log.dt >= _SECONDS:
            break
    most = max(_WINDOWS, round(_SECONDS / (length * log.dt)))
    return tuple(_open_loop(model, unseen, *window) for window in chosen[:most])


def coordinates(model: ComplementarityModel, q: np.ndarray) -> np.ndarray:
    """q (..., nq) as one number per coordinate (..., nv): places of joints; of rotations, the vector from q0."""
    scene = model.scene
    out = scene.difference(np.broadcast_to(scene.q0, q.shape), q)
    for joint in scene.joints:
        if joint.kind != JointKind.BALL:
            out[..., joint.vadr] = q[..., joint.qadr]
    return out


def _by_error(unseen: Unseen, found: OneStep) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows of each held-out block with the parameters fitted without it; those of median error come first."""
    block, rows = blocks_of(unseen.log), np.concatenate(_thinned(unseen))
    error = np.minimum(np.abs(found.after / found.spread), 10.0).mean(axis=1)
    theta = {int(b): t for own, t in zip(unseen.rows, unseen.theta, strict=True) for b in np.unique(block[own])}
    mean = {b: float(error[block[rows] == b].mean()) for b in theta if np.any(block[rows] == b)}
    middle = float(np.median(list(mean.values())))
    order = sorted(mean, key=lambda b: (abs(mean[b] - middle), b))
    return [(np.flatnonzero(block == b), theta[b]) for b in order]


def _thinned(unseen: Unseen) -> list[np.ndarray]:
    """Held-out rows by fold, at most MOST_ROWS."""
    keep = max(1, -(-sum(map(len, unseen.rows)) // MOST_ROWS))
    return [rows[::keep] for rows in unseen.rows]


def _cut(rows: np.ndarray, length: int) -> Sequence[tuple[int, int]]:
    """First row and steps of windows that cover ``rows``, which are consecutive; the last may be half as long."""
    parts = [(int(first), int(min(length, rows[-1] + 1 - first))) for first in rows[::length]]
    return [(first, steps) for first, steps in parts if 2 * steps >= min(length, len(rows))]


def _open_loop(model: ComplementarityModel, unseen: Unseen, first: int, steps: int, theta: np.ndarray) -> Window:
    rows = np.arange(first, first + steps)
    states = []
    for values in (unseen.nominal, theta):
        physical, psi = unseen.observation.split(values)
        seen = unseen.observation.states(unseen.log, psi, rows)
        q, v = seen.q[:1], seen.v[:1]
        path, own = [q], unseen.observation.own_integral(psi, model.scene.nq)
        for u, logged in zip(seen.u, seen.q, strict=True):
            step = model.predict(q, v, own(u[None], q, logged), theta=physical)
            q, v = step.q_next, step.v_next
            path.append(q)
        told = np.concatenate(path)
        told[:, unseen.observation.joints_q] += psi[: len(unseen.observation.joints_q)]
        states.append(coordinates(model, told))
    true = np.concatenate([unseen.log.q[first : first + 1], unseen.log.q_next[rows]])
    return Window(coordinates(model, true), *states)
