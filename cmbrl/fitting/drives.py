"""Where to look for limits of forces and for backlash: levels to start from, from what the log asks of the motors.

A limit that nothing reaches has no derivative, and files of robots often have none. So each actuator by itself is tried
with limits at shares of the force that its law asks for over the log, and with limits that fall with speed, as those
of a DC motor at its voltage do; the others stay as they are. A fit goes on from the best levels, of those actuators
only for which one lowers the loss.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.loss import PredictionLoss
from cmbrl.fitting.space import Space
from cmbrl.scene import Scene

LIMIT, FADE, GAP = "force_limit", "force_limit_slope", "backlash"
_SHARES = (0.9, 0.75, 0.6, 0.45, 0.33, 0.24, 0.17, 0.12)  # of the largest force that the log asks for
_STALL, _FASTEST = (1.0, 2.0), (1.0, 1.4, 2.0)  # in the largest force and speed of the log: at rest, without load
_GAPS = (0.001, 0.003, 0.01, 0.03)  # [rad]; a tenth of it [m]
_SLIDE = 0.1
GROUPS = (LIMIT, GAP)  #: in the order in which they are tried
CLEARLY = 0.1  #: the same of the file's loss, for limits that come before all other parameters
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


def levels(group: str, loss: PredictionLoss, theta: np.ndarray) -> list[dict[str, float]]:
    """Values of one actuator's parameters each, to try for ``group`` at parameters ``theta`` (n,)."""
    scene = loss.model.scene
    physical, psi = loss.observation.split(theta)
    seen = loss.observation.states(loss.windows.data, psi)
    forces = np.abs(asked(scene, physical, seen))
    value = dict(zip((p.name for p in scene.parameters), physical.tolist(), strict=True))
    unit = {p.name: p.unit for p in scene.parameters}
    found: list[dict[str, float]] = []
    for k, name in enumerate(scene.actuator_names):
        limit, fade, gap = (f"{each}.{name}" for each in (LIMIT, FADE, GAP))
        if group == GAP and gap in value:
            found += [{gap: x * (_SLIDE if unit[gap] == "m" else 1.0)} for x in _GAPS]
        most = min(float(forces[:, k].max()), value.get(limit, 0.0))
        if group != LIMIT or not most:
            continue
        found += [{limit: share * most, fade: 0.0} for share in _SHARES]
        fastest = float(np.abs(seen.v[:, scene.core.act_line[k]]).max())
        found += [{limit: s * most, fade: s * most / (f * fastest)} for s in _STALL for f in _FASTEST if fastest > 0.0]
    return found


def scanned(
    group: str, loss: PredictionLoss, space: Space, z: np.ndarray, least: float = LEAST
) -> tuple[np.ndarray, np.ndarray]:
    """``z`` (n,) with the best levels of each actuator by itself, and the mask (n,) of the parameters that help.

    ``least``: the share of the loss by which they have to lower it.
    """
    theta, column = space.theta(z), {name: k for k, name in enumerate(space.names)}
    tried, points = levels(group, loss, theta), [theta]
    for values in tried:
        points.append(theta.copy())
        for name, value in values.items():
            points[-1][column[name]] = np.clip(value, space.low[column[name]], space.high[column[name]])
    losses = loss.values(np.array(points))
    start, helps = z.copy(), np.zeros(len(space), dtype=bool)
    for first in dict.fromkeys(next(iter(values)) for values in tried):
        own = [k + 1 for k, values in enumerate(tried) if first in values]
        best = own[int(np.argmin(np.nan_to_num(losses[own], nan=np.inf)))]
        if losses[best] < (1.0 - least) * losses[0]:
            for name in tried[best - 1]:
                start[column[name]] = space.z(points[best])[column[name]]
                helps[column[name]] = points[best][column[name]] != 0.0
    return start, helps


def unneeded(loss: PredictionLoss, space: Space, z: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Mask (n,) of the ``active`` laws of single actuators without which the loss at ``z`` (n,) is the same."""
    found = np.zeros(len(space), dtype=bool)
    groups = np.array(space.groups)
    for law in ((LIMIT, FADE), (GAP,)):
        moved = np.flatnonzero(active & np.isin(groups, law))
        actuators = [space.names[k].partition(".")[2] for k in moved]
        own = [moved[[a == name for a in actuators]] for name in dict.fromkeys(actuators)]
        points = np.tile(z, (1 + len(own), 1))
        for row, columns in enumerate(own):
            points[1 + row, columns] = 0.0
        losses = loss.values(space.theta(points)) if own else np.zeros(1)
        for value, columns in zip(losses[1:], own, strict=True):
            found[columns] = value <= (1.0 + LEAST) * losses[0]
    return found
