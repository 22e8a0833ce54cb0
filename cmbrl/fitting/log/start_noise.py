"""How far the starts of predictions are off where only positions were logged and nothing pulls back.

A base that floats, a joint under a torque, a pole on a cart: a start whose velocity is an estimate drifts, and takes
along what is joined to it. In a log of a walking robot the errors of starts are several times those of encoders. No
parameter explains them, but armature, damping and delay make up for them where they may, so that a fit finds too much
of one and too little of the other (errors in variables: Fuller, Measurement Error Models, 1987). Hence each window
starts anywhere within these errors (``starts``). Joints that a servo or much damping holds forget theirs.

They show in the first steps of predictions, which begin where the log is and drift apart evenly: v t. White noise of
places, known by itself, is taken out of that. Accelerations that the model lacks are in it too, which leaves a window
freer than it has to be, and no worse. Places that were smoothed, as of a capture that is slower than the joints, show
no white noise; where a local polynomial told their velocity over a time T they are off by about its error times T / 2.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.position_log import free_joint
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.noise import sensor_noise
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.models.windows import noise_of_positions, thinned
from cmbrl.scene.records import JointKind

_SHARE, _LEAST_STEPS = 0.2, 4  # of the horizon, and at least so many steps, over which the drift is told
_TO_DEVIATION = 1.4826  # of a normal distribution, from its median absolute deviation
_LEAST = 0.3  # of the drift, that is left to the velocity
_WINDOWS, _FEWEST, _RUNS = 24, 8, 600  # to tell by: windows, and predictions of all of them for each coordinate
_FASTER, _GOES_ON = 1e-3, 0.5  # rad/s, m/s; of x t, or of x
_SEED = 0
_MOST = 5000  # rows to tell by


def noise_of_starts(evidence: Evidence, theta: np.ndarray, horizon: int, most: int = _MOST) -> np.ndarray | None:
    """Standard deviations (logs, 2 nv) by which starts of predictions are off at ``theta`` (n,); None for exact ones.

    Of states, that of the sensors (:func:`~cmbrl.fitting.log.noise.sensor_noise`); of positions, of what is ``adrift``.
    About ``most`` rows are predicted.
    """
    if not evidence.positions_only:
        return sensor_noise(evidence, theta, most)
    free, steps = adrift(evidence, horizon), _steps(horizon)
    if not len(free):
        return None
    off = _drift(evidence, theta, free, steps, most)
    time = evidence.log.dt * np.arange(1, steps + 1)
    speed = np.einsum("sjc,j->sc", off, time / (time @ time))
    drift = _TO_DEVIATION * np.median(np.abs(np.nan_to_num(speed)), axis=0)
    scene = evidence.model.scene
    white = noise_of_positions(scene, evidence.log)[free]
    of_white = white * np.sqrt((time.sum() / (time @ time)) ** 2 + 1.0 / (time @ time))
    rate = np.sqrt(np.maximum(drift**2 - of_white**2, (_LEAST * drift) ** 2))
    noise = np.zeros(2 * scene.nv)
    noise[free], noise[free + scene.nv] = np.maximum(white, 0.5 * time[-1] * rate), rate
    return np.tile(noise, (len(evidence.names), 1)) if noise.any() else None


def adrift(evidence: Evidence, horizon: int) -> np.ndarray:
    """Places in v of bodies that float, and of what goes on as it begins: faster by x, it ends ahead by most of x t.

    By the file, over some windows of the ``horizon``: what a servo or damping has pulled back by its end needs no start
    of its own, and would hide in one that the file's damping is wrong. What no actuator drives and swings, such as a
    hanging load, comes back without forgetting: it counts where it is faster or slower by most of x in the second half.
    None of them of a log of states.
    """
    if not evidence.positions_only:
        return np.empty(0, dtype=np.int64)
    if horizon not in evidence.drifting:
        evidence.drifting[horizon] = _adrift(evidence, horizon)
    return evidence.drifting[horizon]


def _adrift(evidence: Evidence, steps: int) -> np.ndarray:
    scene, model = evidence.model.scene, evidence.model
    physical, log = evidence.seen(evidence.space.nominal)
    starts = thinned(log.windows(steps), int(np.clip(_RUNS / (scene.nv + 1), _FEWEST, _WINDOWS)))
    kinds = np.arange(scene.nv + 1)  # one coordinate faster, or none
    q, v = (np.tile(x[starts], (len(kinds), 1)) for x in (log.q, log.v))
    row, kind = np.arange(len(q)), np.repeat(kinds, len(starts))
    faster = kind < scene.nv
    v[row[faster], kind[faster]] += _FASTER
    own, swings = (np.arange(scene.nv * len(starts)), kind[faster]), np.zeros(scene.nv)
    for j in range(steps):
        step = model.predict(q, v, np.tile(log.u[starts + j], (len(kinds), 1)), theta=physical)
        q, v = step.q_next, step.v_next
        if 2 * j >= steps:
            change = (v[faster] - np.tile(v[~faster], (scene.nv, 1)))[own] / _FASTER
            swings = np.maximum(swings, _typical(np.abs(change), scene.nv))
    alike, moved = np.tile(q[~faster], (scene.nv, 1)), q[faster]
    share = _typical(scene.difference(alike, moved)[own] / (_FASTER * steps * log.dt), scene.nv)
    driven = np.isin(kinds[:-1], scene.core.act_line)
    goes_on = (share > _GOES_ON) | ((swings > _GOES_ON) & ~driven)
    floats = [
        place
        for joint in scene.joints
        if free_joint(scene) == scene.joint_names[joint.source]
        for place in range(joint.vadr, joint.vadr + (3 if joint.kind == JointKind.BALL else 1))
    ]
    return np.flatnonzero((goes_on & evidence.measured) | np.isin(kinds[:-1], floats))


def _typical(change: np.ndarray, count: int) -> np.ndarray:
    """Medians (``count``,) over windows, of as many for each coordinate."""
    return np.asarray(np.median(np.nan_to_num(change).reshape(count, -1), axis=1))


def _steps(horizon: int) -> int:
    """The first of ``horizon`` steps, in which a drift is told."""
    return min(max(_LEAST_STEPS, round(_SHARE * horizon)), horizon)


def _drift(evidence: Evidence, theta: np.ndarray, free: np.ndarray, steps: int, most: int) -> np.ndarray:
    """By how much (s, ``steps``, c) predictions miss the places ``free`` (c,) after each of the first steps."""
    scene = evidence.model.scene
    physical, log = evidence.seen(theta)
    starts = draw_starts(evidence.log, steps, most, _SEED)
    q, v, found = log.q[starts], log.v[starts], np.empty((len(starts), steps, len(free)))
    for j in range(steps):
        step = evidence.model.predict(q, v, log.u[starts + j], theta=physical)
        q, v = step.q_next, step.v_next
        found[:, j] = scene.difference(log.q_next[starts + j], q)[:, free]
    return found
