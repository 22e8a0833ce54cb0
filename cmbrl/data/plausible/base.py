"""The pose of a base, from motion capture or an estimator: its unit, the order of its quaternion, and lost markers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.readings import ORDERS
from cmbrl.data.plausible.still import LONG, MEANT, loud
from cmbrl.data.plausible.unlimited import IMPOSSIBLE, UNITS, acceleration, unit_of
from cmbrl.data.stretches import between, stretches
from cmbrl.scene.records import WORLD, JointKind

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene

SAME = 1e-9  #: [m] of a place that does not move, whatever read it in between
POSES = 20
OFF, ON = 0.06, 0.03  #: [m] of the lowest point from the floor
ALOFT = 20.0  #: [m] from the floor: what moves by joints does not fly so high


def of_positions(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """All faults of the base of ``log``, if it has one."""
    if log.base is None:
        return
    yield from _unit(log)
    yield from _stuck(log)
    yield from _floor(log, scene)


def _unit(log: PositionLog) -> Iterator[Finding]:
    assert log.base is not None
    usual = acceleration(log.base[:, :3], between(np.diff(log.episode) != 0), log.dt)
    if usual > IMPOSSIBLE:
        yield Finding(f"base_position accelerates by {usual:.3g} m/s^2: {unit_of(usual)}")


def _stuck(log: PositionLog) -> Iterator[Finding]:
    assert log.base is not None
    still = (np.abs(np.diff(log.base, axis=0)) < SAME).all(axis=1) & (np.diff(log.episode) == 0)
    blocks = between(np.diff(log.episode) != 0)
    for begin, end in stretches(still):
        if end - begin < LONG:
            continue
        run = slice(begin, end + 1)
        moves = np.ptp(log.position[run], axis=0).max(initial=0.0) > MEANT
        if moves or any(loud(x, blocks, run) for x in log.base.T):
            cause = "while joints move" if moves else "without the noise that they have elsewhere"
            yield Finding(
                f"base_position and base_quaternion are constant from row {begin} to {end} {cause}: did the capture "
                "lose its markers? Leave these rows out, or give the parts as episodes"
            )
            return


def _floor(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """Whether the robot is on its floor only in another unit, or with the quaternion in the other order.

    A robot that rests or stands accelerates too little to tell millimetres by that.
    """
    assert log.base is not None
    core = scene.core
    floor = np.array([WORLD in pair for pair in zip(core.con_bodyA, core.con_bodyB, strict=True)], dtype=bool)
    balls = [joint for joint in scene.joints if joint.kind == JointKind.BALL]
    if not floor.any() or len(balls) != 1:
        return
    rows = np.unique(np.linspace(0, len(log) - 1, POSES).astype(int))
    address = {joint.vadr: joint.qadr for joint in scene.joints}
    q = np.tile(scene.q0, (len(rows), 1))
    q[:, [address[place] for place in log.coordinates(scene).tolist()]] = log.position[rows]
    turn = balls[0].qadr

    def off(place: np.ndarray, turned: np.ndarray) -> float:
        q[:, turn - 3 : turn], q[:, turn : turn + 4] = place, turned
        return float(np.median(np.abs(scene.gaps(q)[:, floor].min(axis=1))))

    place, turned = log.base[rows, :3], log.base[rows, 3:]
    if (own := off(place, turned)) <= OFF:
        return
    aloft = own > ALOFT and log.position.size > 0
    heights = {factor: off(place / factor, turned) for factor in UNITS} if aloft else {}
    if heights and min(heights.values()) < OFF:
        factor = min(heights, key=lambda each: heights[each])
        yield Finding(
            f"by base_position the robot is {own:.3g} m off its floor, and on it if these are {UNITS[factor]} instead "
            f"of metres: divide base_position by {factor:.0f}"
        )
        return
    orders = {text: off(place, reading(turned)) for text, reading in ORDERS.items()}
    if min(orders.values()) < ON:
        text = next(text for text, height in orders.items() if height < ON)
        yield Finding(
            f"by base_quaternion the robot is {own:.2g} m off its floor, and stands on it if the order is another: "
            f"{text}"
        )
