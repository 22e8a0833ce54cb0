"""Where to look for limits of forces and for backlash: levels to start from, from what the log asks of the motors.

A limit that nothing reaches has no derivative, and files of robots often have none. So each actuator by itself is tried
with limits at shares of the force that its law asks for over the log, and with limits that fall with speed, as those
of a DC motor at its voltage do; the others stay as they are. A fit goes on from the best levels, of those actuators
only for which one lowers the loss.

A gap costs a servo that moves as much force as dry friction does, so a fit without gaps has put it into friction. Each
gap is therefore tried beside the friction that was found, and in exchange for as much of it.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.space import Space
from cmbrl.scene import Scene

LIMIT, FADE, GAP = "force_limit", "force_limit_slope", "backlash"
_FRICTION = "frictionloss"
_SHARES = (0.9, 0.75, 0.6, 0.45, 0.33, 0.24, 0.17, 0.12)  # of the largest force that the log asks for
_STALL, _FASTEST = (1.0, 2.0), (1.0, 1.4, 2.0)  # in the largest force and speed of the log: at rest, without load
_GAPS = (0.001, 0.003, 0.01, 0.03)  # [rad]; a tenth of it [m]
_SLIDE = 0.1
GROUPS = (LIMIT, GAP)  #: in the order in which they are tried
CLEARLY = 0.1  #: the same of the file's loss, for limits that come before all other parameters
LEAST = 0.002  #: share of the loss by which a law of one actuator has to lower it
_ROWS = 1500  # that a scan predicts


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


def levels(group: str, loss: PredictionLoss, theta: np.ndarray, lines: bool = True) -> list[dict[str, float]]:
    """Values of one actuator's parameters each, to try for ``group`` at parameters ``theta`` (n,).

    ``lines``: also limits that fall with speed.
    """
    scene = loss.model.scene
    physical, psi = loss.observation.split(theta)
    seen = loss.observation.states(loss.windows.data, psi)
    forces = np.abs(asked(scene, physical, seen))
    value = dict(zip((p.name for p in scene.parameters), physical.tolist(), strict=True))
    unit, costs = {p.name: p.unit for p in scene.parameters}, _costs(scene, physical)
    found: list[dict[str, float]] = []
    for k, name in enumerate(scene.actuator_names):
        limit, fade, gap = (f"{each}.{name}" for each in (LIMIT, FADE, GAP))
        if group == GAP and gap in value:
            sizes = [x * (_SLIDE if unit[gap] == "m" else 1.0) for x in _GAPS]
            found += [{gap: x} for x in sizes]
            found += [{gap: x, loss_of: value[loss_of] - x * cost} for loss_of, cost in costs[gap] for x in sizes]
        most = min(float(forces[:, k].max()), value.get(limit, 0.0))
        if group != LIMIT or not most:
            continue
        found += [{limit: share * most, fade: 0.0} for share in _SHARES]
        fastest = float(np.abs(seen.v[:, scene.core.act_line[k]]).max()) if lines else 0.0
        found += [{limit: s * most, fade: s * most / (f * fastest)} for s in _STALL for f in _FASTEST if fastest > 0.0]
    return found


def _costs(scene: Scene, physical: np.ndarray) -> dict[str, list[tuple[str, float]]]:
    """By backlash: the friction loss of its joint, if there is one, and the force [N m, N] that a unit of it costs."""
    known, P = {p.name for p in scene.parameters}, scene.physical_vector(physical)
    found: dict[str, list[tuple[str, float]]] = {}
    for k, line in enumerate(scene.core.act_line.tolist()):
        gear, _, _, stiffness = P[scene.layout.actuator(k) : scene.layout.actuator(k) + 4]
        friction = f"{_FRICTION}.{scene.coordinate_names[line]}" if 0 <= line < scene.nv else ""
        cost = 0.5 * abs(stiffness) * gear**2
        found[f"{GAP}.{scene.actuator_names[k]}"] = [(friction, cost)] if friction in known else []
    return found


def scanned(
    group: str, loss: PredictionLoss, space: Space, z: np.ndarray, least: float = 0.0, lines: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """``z`` (n,) with the best levels of each actuator, and the mask (n,) of the parameters that help.

    First all actuators alike, since what one cannot do moves the others too; then one by one, beside the best of those
    before. None helps unless all together lower the loss by the share ``least``. ``lines``: as for ``levels``.
    """
    some = loss.on(loss.windows.starts[:: max(1, loss.steps // _ROWS)]).settled(space.theta(z))
    theta, column = space.theta(z), {name: k for k, name in enumerate(space.names)}
    tried, best = levels(group, some, theta, lines), theta.copy()
    own: dict[str, list[dict[str, float]]] = {}
    for values in tried:
        own.setdefault(next(iter(values)), []).append(values)

    def at(point: np.ndarray, *changes: dict[str, float]) -> np.ndarray:
        moved = point.copy()
        for name, value in (item for values in changes for item in values.items()):
            moved[column[name]] = np.clip(value, space.low[column[name]], space.high[column[name]])
        return moved

    def better(points: list[np.ndarray]) -> np.ndarray:
        return points[int(np.argmin(np.nan_to_num(some.values(np.array(points)), nan=np.inf)))]

    if own:
        best = better([best, *(at(best, *alike) for alike in zip(*own.values(), strict=False))])
    for choices in own.values():
        none = {name: theta[column[name]] for values in choices for name in values}
        best = better([best, *(at(best, values) for values in [none, *choices])])
    moved = (best != theta) & np.isin(space.names, [name for values in tried for name in values])
    start = np.where(moved, space.z(best), z)
    start, idle = without_unneeded(some, space, start, moved, z)
    helps = moved & ~idle & (start != z)
    before, after = some.values(space.theta(np.stack([z, np.where(helps, start, z)])))
    if not after < (1.0 - least) * before:
        return z.copy(), np.zeros_like(helps)
    return np.where(helps, start, z), helps


def without_unneeded(
    loss: PredictionLoss, space: Space, z: np.ndarray, active: np.ndarray, without: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """``z`` (n,) less the ``active`` laws of single actuators without which the loss is hardly higher, and their mask.

    ``without`` (n,): where they are then; default: at the file's values. Friction may take the part of a gap.
    """
    without, loss = np.zeros_like(z) if without is None else without, loss.settled(space.theta(z))
    found, left = np.zeros(len(space), dtype=bool), z.copy()
    groups = np.array(space.groups)
    for law in ((LIMIT, FADE), (GAP,)):
        moved = np.flatnonzero(active & np.isin(groups, law))
        actuators = [space.names[k].partition(".")[2] for k in moved]
        own = [moved[[a == name for a in actuators]] for name in dict.fromkeys(actuators)]
        points = [np.where(np.isin(np.arange(len(z)), columns), without, z) for columns in own]
        points += [rubbing(loss, space, z, point) for point in points] if law == (GAP,) else []
        losses = loss.values(space.theta(np.stack([z, *points])))
        ways = losses[1:].reshape(-1, len(own)) if own else np.empty((1, 0))
        for k, columns in enumerate(own):
            best = int(np.argmin(ways[:, k]))
            if ways[best, k] <= (1.0 + LEAST) * losses[0]:
                found[columns] = True
                left = np.where(points[best * len(own) + k] != z, points[best * len(own) + k], left)
    return left, found


def rubbing(loss: PredictionLoss, space: Space, z: np.ndarray, point: np.ndarray) -> np.ndarray:
    """``point`` (n,) with as much more friction as its smaller gaps cost less than those of ``z`` (n,)."""
    theta, moved = space.theta(z), space.theta(point)
    column = {name: k for k, name in enumerate(space.names)}
    for gap, paid in _costs(loss.model.scene, loss.observation.split(theta)[0]).items():
        for friction, cost in paid if gap in column else ():
            more = cost * (theta[column[gap]] - moved[column[gap]])
            moved[column[friction]] = np.clip(
                moved[column[friction]] + more, space.low[column[friction]], space.high[column[friction]]
            )
    return np.where(moved != space.theta(point), space.z(moved), point)
