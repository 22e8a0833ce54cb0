"""How far joints can carry a point: bounds that prove that two geoms never meet.

Limits are soft, so slides get slack (a tenth of their range and 5 cm). Hinges turn freely here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.scene.collision.shapes import Shape
from cmbrl.scene.records import WORLD, Array, Joint, JointKind, Tree
from cmbrl.scene.source.mjcf import limits_act

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


class Balls:
    """Balls that geoms stay in, by geom and by how much of its chain is held; each is found once."""

    def __init__(self, model: mujoco.MjModel, tree: Tree) -> None:
        self.model, self.tree = model, tree
        self._chains = [tree.chain(body) for body in range(len(tree.bodies))]
        self._balls: dict[tuple[int, int], tuple[list[float], float]] = {}

    def closest_approach(self, a: Shape, b: Shape) -> float:
        """Lower bound [m], possibly negative, on the distance between the centres of two shapes of different bodies."""
        path_a, path_b = (self._chains[shape.body] if shape.body != WORLD else [] for shape in (a, b))
        shared = 0
        while shared < min(len(path_a), len(path_b)) and path_a[shared] == path_b[shared]:
            shared += 1
        (from_a, slack_a), (from_b, slack_b) = self._ball(a, path_a, shared), self._ball(b, path_b, shared)
        if math.isinf(slack_a) or math.isinf(slack_b):
            return -math.inf
        return math.dist(from_a, from_b) - slack_a - slack_b

    def _ball(self, shape: Shape, path: list[int], held: int) -> tuple[list[float], float]:
        if (shape.geom, held) not in self._balls:
            centre, radius = _ball(self.model, self.tree, shape, path[held:])
            self._balls[shape.geom, held] = centre.tolist(), radius
        return self._balls[shape.geom, held]


def _ball(model: mujoco.MjModel, tree: Tree, shape: Shape, path: list[int]) -> tuple[Array, float]:
    """Centre (3,) and radius [m] of a ball that the joints of ``path`` cannot carry a shape's centre out of."""
    joints = [(index, joint) for index in path for joint in tree.bodies[index].joints]
    end = tree.place(shape.body, shape.pos)
    centre, slack = end, 0.0
    while joints and joints[0][1].kind == JointKind.SLIDE:
        slack += max(abs(x) for x in _travel(model, joints[0][1]))
        joints = joints[1:]
    if joints:
        centre = tree.place(joints[0][0], joints[0][1].pos)
        slack += _arm(model, tree, joints, end)
    return centre, slack


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
