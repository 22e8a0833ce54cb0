"""The pose of a base, from motion capture or an estimator: its unit, the order of its quaternion, and lost markers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.readings import ORDERS
from cmbrl.data.plausible.still import LONG, MEANT, loud
from cmbrl.scene.records import WORLD, JointKind

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene

STRIDE = 0.1  #: [s] over which accelerations are taken
IMPOSSIBLE = 200.0  #: [m/s^2] of a robot's base, root mean square
LEAST, MOST = 0.1, 20.0  #: the same, as usual
UNITS = {1e3: "millimetres", 1e2: "centimetres"}
SAME = 1e-9  #: [m] of a place that does not move, whatever read it in between
POSES = 20
OFF, ON = 0.06, 0.03  #: [m] of the lowest point from the floor


def of_positions(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """All faults of the base of ``log``, if it has one."""
    if log.base is None:
        return
    yield from _unit(log)
    yield from _stuck(log)
    yield from _order(log, scene)


def _unit(log: PositionLog) -> Iterator[Finding]:
    assert log.base is not None
    step = max(1, round(STRIDE / log.dt))
    rows = np.arange(step, len(log) - step)
    rows = rows[log.episode[rows - step] == log.episode[rows + step]]
    if not len(rows):
        return
    place = log.base[:, :3]
    bend = (place[rows + step] - 2 * place[rows] + place[rows - step]) / (step * log.dt) ** 2
    usual = float(np.sqrt((bend**2).sum(axis=1).mean()))
    if usual > IMPOSSIBLE:
        yield Finding(f"base_position accelerates by {usual:.3g} m/s^2: {_unit_of(usual)}")


def _unit_of(usual: float) -> str:
    """The unit in which a base accelerates by ``usual`` [1/s^2]; both where one moves fast, or the other slowly."""
    likely = [factor for factor in UNITS if LEAST < usual / factor < MOST] or [max(UNITS)]
    names = " or ".join(UNITS[factor] for factor in likely)
    divide = " or ".join(f"{factor:.0f}" for factor in likely)
    return f"{names} instead of metres? Divide it by {divide}"


def _stuck(log: PositionLog) -> Iterator[Finding]:
    assert log.base is not None
    still = (np.abs(np.diff(log.base, axis=0)) < SAME).all(axis=1) & (np.diff(log.episode) == 0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    ends = np.flatnonzero(np.diff(log.episode)) + 1
    blocks = [slice(*pair) for pair in pairwise([0, *ends.tolist(), len(log)])]
    for begin, end in edges.reshape(-1, 2).tolist():
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


def _order(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """Whether the robot is on its floor only with the quaternion in the other order."""
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
    q[:, turn - 3 : turn] = log.base[rows, :3]
    off = []
    for turned in (log.base[rows, 3:], *(reading(log.base[rows, 3:]) for reading in ORDERS.values())):
        q[:, turn : turn + 4] = turned
        off.append(float(np.median(np.abs(scene.gaps(q)[:, floor].min(axis=1)))))
    if off[0] > OFF and min(off) < ON:
        text = next(text for text, height in zip(ORDERS, off[1:], strict=True) if height < ON)
        yield Finding(
            f"by base_quaternion the robot is {off[0]:.2g} m off its floor, and stands on it if the order is another: "
            f"{text}"
        )
