"""How far joints can carry a point: bounds that prove that two geoms never meet.

Limits are soft, so slides get slack (a tenth of their range and 5 cm). Hinges turn freely here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.scene.mjcf import limits_act
from cmbrl.scene.records import Array, Joint, JointKind, Tree

_PARALLEL = 1e-9


@dataclass(frozen=True)
class HeightRange:
    """Bounds [m] of a point's coordinate along a direction; ``constant``: no joint can change it."""

    low: float
    high: float
    constant: bool


def height_range(model: mujoco.MjModel, tree: Tree, body: int, point: Array, direction: Array) -> HeightRange:
    """Range of ``direction . x`` for a point (3,) of a moving body; ``direction`` (3,) is a unit vector of the world.

    Rotation about ``direction`` changes no height. After the first other rotation, the point stays within a sphere.
    """
    low = high = float(direction @ tree.place(body, point))
    moves = False
    chain = [(index, joint) for index in tree.chain(body) for joint in tree.bodies[index].joints]
    for k, (index, joint) in enumerate(chain):
        if joint.kind == JointKind.SLIDE:
            slope = float(direction @ tree.turn(index, joint.axis))
            if abs(slope) > _PARALLEL:
                moves = True
                ends = slope * np.array(_travel(model, joint))
                low, high = low + float(ends.min()), high + float(ends.max())
        elif abs(direction @ tree.turn(index, joint.axis)) < 1 - _PARALLEL:  # a ball joint has axis zero
            anchor = float(direction @ tree.place(index, joint.pos))
            now = float(direction @ tree.place(body, point))
            radius = _arm(model, tree, chain[k:], tree.place(body, point))
            return HeightRange(low - now + anchor - radius, high - now + anchor + radius, False)
    return HeightRange(low, high, not moves)


def closest_approach(
    model: mujoco.MjModel, tree: Tree, body_a: int, point_a: Array, body_b: int, point_b: Array
) -> float:
    """Lower bound [m], possibly negative, on the distance between two points of different bodies."""
    path_a, path_b = tree.chain(body_a), tree.chain(body_b)
    shared = 0
    while shared < min(len(path_a), len(path_b)) and path_a[shared] == path_b[shared]:
        shared += 1
    balls = []
    for body, point, path in ((body_a, point_a, path_a), (body_b, point_b, path_b)):
        joints = [(index, joint) for index in path[shared:] for joint in tree.bodies[index].joints]
        end = tree.place(body, point)
        centre, slack = end, 0.0
        while joints and joints[0][1].kind == JointKind.SLIDE:
            slack += max(abs(x) for x in _travel(model, joints[0][1]))
            joints = joints[1:]
        if joints:
            centre = tree.place(joints[0][0], joints[0][1].pos)
            slack += _arm(model, tree, joints, end)
        balls.append((centre, slack))
    return float(np.linalg.norm(balls[0][0] - balls[1][0])) - balls[0][1] - balls[1][1]


def _arm(model: mujoco.MjModel, tree: Tree, joints: Sequence[tuple[int, Joint]], end: Array) -> float:
    """Largest distance [m] from the first joint's anchor to ``end`` (world, at qpos0) over all joint positions."""
    length, last = 0.0, tree.place(joints[0][0], joints[0][1].pos)
    for index, joint in joints[1:]:
        if joint.kind == JointKind.SLIDE:
            length += max(abs(x) for x in _travel(model, joint))
        else:
            anchor = tree.place(index, joint.pos)
            length, last = length + float(np.linalg.norm(anchor - last)), anchor
    return length + float(np.linalg.norm(end - last))


def _travel(model: mujoco.MjModel, joint: Joint) -> tuple[float, float]:
    """Smallest and largest displacement [m] of a slide from qpos0."""
    if not (limits_act(model) and model.jnt_limited[joint.source]):
        return -np.inf, np.inf
    low, high = model.jnt_range[joint.source]
    slack = 0.1 * (high - low) + 0.05
    return float(low - joint.q0 - slack), float(high - joint.q0 + slack)
