"""Where to look for limits of forces and rates and for backlash: levels to start from, from what the log asks for.

A limit that nothing reaches has no derivative, and files of robots often have none. So each actuator by itself is tried
with limits at shares of the force that its law asks for over the log, and about those that its motion shows
(``given``), which may fall with speed, as those of a DC motor at its voltage do; the others stay as they are. A fit
goes on from the best levels, of those actuators only for which one lowers the loss.

A gap costs a servo that moves as much force as dry friction does, so a fit without gaps has put it into friction. Each
gap is therefore tried beside the friction that was found, and in exchange for as much of it.
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.choice.given import asked, shown_limits
from cmbrl.fitting.log.ramps import shown_ramps
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.space import Space
from cmbrl.models.between.parameters import RAMP
from cmbrl.scene import Scene

LIMIT, FADE, GAP = "force_limit", "force_limit_slope", "backlash"
_FRICTION = "frictionloss"
_SHARES = (0.9, 0.6, 0.4, 0.25, 0.15)  # of the largest force that the log asks for
_ABOUT = (0.8, 1.0, 1.25)  # times the line that motion shows
_GAPS = (0.001, 0.003, 0.01, 0.03)  # [rad]; a tenth of it [m]
_SLIDE = 0.1
GROUPS = (LIMIT, RAMP, GAP)  #: in the order in which they are tried
FIRST = (LIMIT, RAMP)  #: which may come before all other parameters
CLEARLY = 0.1  #: the same of the file's loss, for those
LEAST = 0.002  #: share of the loss by which a law of one actuator has to lower it
_ROWS = 1500  # that a scan predicts


def levels(group: str, loss: PredictionLoss, theta: np.ndarray) -> list[dict[str, float]]:
    """Values of one actuator's parameters each, to try for ``group`` at parameters ``theta`` (n,)."""
    if group == RAMP:
        return [values for own in shown_ramps(loss, theta) for values in own]
    scene = loss.model.scene
    physical, psi = loss.observation.split(theta)
    seen = loss.observation.states(loss.windows.data, psi)
    forces = np.abs(asked(scene, physical, seen))
    value = dict(zip((p.name for p in scene.parameters), physical.tolist(), strict=True))
    unit, costs = {p.name: p.unit for p in scene.parameters}, _costs(scene, physical)
    shown = shown_limits(loss, theta) if group == LIMIT else {}
    found: list[dict[str, float]] = []
    for k, name in enumerate(scene.actuator_names):
        limit, fade, gap = (f"{each}.{name}" for each in (LIMIT, FADE, GAP))
        if group == GAP and gap in value:
            sizes = [x * (_SLIDE if unit[gap] == "m" else 1.0) for x in _GAPS]
            found += [{gap: x} for x in sizes]
            found += [{gap: x, loss_of: value[loss_of] - x * cost} for loss_of, cost in costs[gap] for x in sizes]
        most = min(float(forces[:, k].max()), value.get(limit, 0.0))
        if k not in shown or not most:
            continue
        (high, slope), alone = shown[k]
        found += [{limit: x, fade: 0.0} for x in (*(share * most for share in _SHARES), alone)]
        found += [{limit: x * high, fade: x * slope} for x in _ABOUT]
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
    group: str, loss: PredictionLoss, space: Space, z: np.ndarray, least: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """``z`` (n,) with the best levels of each actuator, and the mask (n,) of the parameters that help.

    First all actuators alike, since what one cannot do moves the others too; then one by one, beside the best of those
    before. None helps unless all together lower the loss by the share ``least``.
    """
    some = loss.on(loss.windows.starts[:: max(1, loss.steps // _ROWS)]).settled(space.theta(z))
    theta, column = space.theta(z), {name: k for k, name in enumerate(space.names)}
    tried, best = levels(group, some, theta), theta.copy()
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
    for law in ((FADE,), (LIMIT, FADE), (RAMP,), (GAP,)):
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
