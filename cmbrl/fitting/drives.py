"""Where to look for limits of forces and for backlash: levels to start from, taken from what the log asks of the motors.

A limit that nothing reaches has no derivative, and files of robots often have none. So each actuator by itself is tried
with limits at quantiles of the force that its law asks for over the log, the others as they are. A fit goes on from the
best levels, of those actuators only for which one lowers the loss.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.loss import PredictionLoss
from cmbrl.fitting.space import Space
from cmbrl.scene import Scene
from cmbrl.scene.actuators import UNLIMITED

LIMIT, FADE, GAP = "force_limit", "force_limit_slope", "backlash"
_QUANTILES = (0.98, 0.9, 0.8, 0.65, 0.5)  # of the force that the log asks for
_FASTEST = (1.0, 1.5, 2.5)  # no-load speeds, in the largest speed of the log
_GAPS = (0.001, 0.003, 0.01, 0.03)  # [rad]; a tenth of it [m]
_SLIDE = 0.1
GROUPS = (LIMIT, FADE, GAP)  #: in the order in which they are tried
LEAST = 0.002  #: share of the loss by which a level has to lower it


def asked(scene: Scene, theta: np.ndarray, log: Transitions) -> np.ndarray:
    """Forces (N, nu) [N m, N] before gears that laws without limits would give over ``log``; 0 but along a joint."""
    core, layout, P = scene.core, scene.layout, scene.physical_vector(theta)
    places = {joint.vadr: joint.qadr for joint in scene.joints}
    low, high = np.reshape(core.act_ctrl, (-1, 2)).T
    control, force = np.clip(log.u[:, : scene.nu], low, high), np.zeros((len(log), scene.nu))
    for k, line in enumerate(core.act_line.tolist()):
        if line in places:
            gear, gain, bias0, bias1, bias2 = P[layout.actuator(k) : layout.actuator(k) + 5]
            pull = bias1 * log.q[:, places[line]] + bias2 * log.v[:, line]
            force[:, k] = gain * control[:, k] + bias0 + gear * pull
    return force


def levels(group: str, loss: PredictionLoss, theta: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Parameters of ``group`` that ``loss`` has, each with the values to try, at parameters ``theta`` (n,)."""
    scene = loss.model.scene
    physical, psi = loss.observation.split(theta)
    seen = loss.observation.states(loss.windows.data, psi)
    forces = np.abs(asked(scene, physical, seen))
    value = dict(zip((p.name for p in scene.parameters), physical.tolist(), strict=True))
    unit = {p.name: p.unit for p in scene.parameters}
    found = []
    for k, name in enumerate(scene.actuator_names):
        own, limit = f"{group}.{name}", value.get(f"{LIMIT}.{name}", 0.0)
        if own not in value or (group == FADE and limit == UNLIMITED):
            continue
        if group == LIMIT:
            tried = np.quantile(forces[:, k], _QUANTILES)
            found.append((own, tried[(tried > 0.0) & (tried < limit)]))
        elif group == FADE:
            fastest = np.abs(seen.v[:, scene.core.act_line[k]]).max() * np.array(_FASTEST)
            found.append((own, np.minimum(limit, forces[:, k].max()) / fastest[fastest > 0.0]))
        else:
            found.append((own, np.array(_GAPS) * (_SLIDE if unit[own] == "m" else 1.0)))
    return found


def scanned(group: str, loss: PredictionLoss, space: Space, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``z`` (n,) with the best level of each parameter of ``group`` by itself, and the mask (n,) of those that help."""
    tried, columns = [z], [-1]
    theta = space.theta(z)
    for name, values in levels(group, loss, theta):
        column = space.names.index(name)
        for value in np.clip(values, space.low[column], space.high[column]):
            point = theta.copy()
            point[column] = value
            tried.append(space.z(point))
            columns.append(column)
    losses, of = loss.values(space.theta(np.array(tried))), np.array(columns)
    start, helps = z.copy(), np.zeros(len(space), dtype=bool)
    for column in np.unique(of[1:]):
        own = np.flatnonzero(of == column)
        best = own[np.nanargmin(losses[own])] if np.isfinite(losses[own]).any() else own[0]
        if losses[best] < (1.0 - LEAST) * losses[0]:
            start[column], helps[column] = tried[best][column], True
    return start, helps
