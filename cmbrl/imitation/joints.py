"""The joints of a robot that imitates: a free root, then a position servo on each, its reach and its soft limits."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError, did_you_mean
from cmbrl.imitation.robot import Robot
from cmbrl.scene import Scene, kinematics

ROOT_Q, ROOT_V = 7, 6  #: coordinates of the root in q and v


def check(robot: Robot, scene: Scene) -> None:
    """Raises UserError unless the scene has a free root and a servo on each joint, and knows the robot's names."""
    kinds = ("position",) * 3 + ("rotation",) * 3
    if scene.coordinate_kinds[:ROOT_V] != kinds or scene.nq != ROOT_Q + scene.nv - ROOT_V:
        raise UserError(f"{scene.name}: imitation needs a free root, and joints of one coordinate each after it")
    stiffness = [-scene.core.P[scene.layout.actuator(i, "bias1")] for i in range(scene.nu)]
    if list(scene.core.act_line) != list(range(ROOT_V, scene.nv)) or not all(k > 0 for k in stiffness):
        raise UserError(f"{scene.name}: imitation needs one position servo for each joint, in the order of the joints")
    if not scene.body_names or robot.tracked[:1] != scene.body_names[:1]:
        raise UserError(f"{scene.name}: the first tracked body has to be the root, {scene.body_names[0]!r}")
    for name in (robot.anchor, *robot.ends):
        if name not in robot.tracked:
            raise UserError(f"{scene.name}: {name!r} is not among the tracked bodies: add it there")
    for name in robot.posture:
        if name not in scene.joint_names:
            raise UserError(f"{scene.name} has no joint {name!r}: {did_you_mean(name, scene.joint_names)}")


def reach(scene: Scene) -> np.ndarray:
    """By how much each servo's target must be away for its largest torque [rad] (nu,)."""
    core, layout = scene.core, scene.layout
    stiffness = np.array([-core.P[layout.actuator(i, "bias1")] for i in range(scene.nu)])
    force = np.abs(np.reshape(core.act_force, (-1, 2))).min(axis=1)
    return np.where(np.isfinite(force), force, math.inf) / stiffness


def soft_limits(scene: Scene, share: float) -> tuple[Tensor, Tensor]:
    """The middle ``share`` of each joint's range, low and high (nu,); infinite where a joint has none."""
    low, high, core = np.full(scene.nq, -np.inf), np.full(scene.nq, np.inf), scene.core
    joint = (core.lim_line < scene.nv) & (core.lim_ball < 0)
    places = kinematics.addresses(core)[core.lim_line[joint]]
    least, most = core.lim_lo[joint], core.lim_hi[joint]
    middle, half = (least + most) / 2, share * (most - least) / 2
    low[places], high[places] = middle - half, middle + half
    return torch.from_numpy(low[ROOT_Q:]), torch.from_numpy(high[ROOT_Q:])
