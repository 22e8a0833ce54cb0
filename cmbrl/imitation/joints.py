"""The joints of a robot that imitates: a root, free or fixed, then joints of one coordinate, most with a servo."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from cmbrl.data.drive import law_of
from cmbrl.errors import UserError, did_you_mean
from cmbrl.imitation.robot import Robot
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene, kinematics
from cmbrl.standing import strongest

ROOT_Q, ROOT_V = 7, 6  #: coordinates of a free root in q and v
FREE_REACH, FREE_SHARE = 0.4, 0.2  # of a servo without a torque limit: rad or m, or less: a share of its joint's range
SIZE = 0.8  # m from the anchor to the farthest body: of a Unitree G1, and of those whom the numbers of tracking fit


def root(scene: Scene) -> tuple[int, int]:
    """How many coordinates the root has in q and v: (7, 6) where it is free, (0, 0) where it is fixed to the world."""
    kinds = ("position",) * 3 + ("rotation",) * 3
    return (ROOT_Q, ROOT_V) if scene.coordinate_kinds[:ROOT_V] == kinds and scene.nq > scene.nv else (0, 0)


def joint_names(scene: Scene) -> tuple[str, ...]:
    """Of the joints after a free root, in the order of their columns."""
    return scene.joint_names[1:] if root(scene)[0] else scene.joint_names


def check(robot: Robot, scene: Scene) -> None:
    """Raises UserError unless the scene has single joints after its root, servos, a floor, and the robot's names."""
    first_q, first_v = root(scene)
    if scene.nq - first_q != scene.nv - first_v or len(joint_names(scene)) != scene.nv - first_v:
        raise UserError(
            f"{scene.name}: imitation needs a root that is free or fixed, and joints of one coordinate each after it"
        )
    if not scene.nu:
        raise UserError(f"{scene.name}: imitation needs servos, and the file has no actuators: add <position>")
    lines = scene.core.act_line.tolist()
    if min(lines) < first_v or len(set(lines)) < len(lines):
        raise UserError(f"{scene.name}: imitation needs actuators of joints or tendons, one each: leave out the others")
    if other := [name for i, name in enumerate(scene.actuator_names) if law_of(scene, i)[0] != "position"]:
        raise UserError(
            f"{scene.name}: imitation needs position servos, and {other[0]!r} is none: give the law of the robot's "
            f'driver, Robot(drives=(Drive("*", "position", kp=..., kd=...),))'
        )
    if first_q and not ground(scene).any():
        remedy = 'add <geom type="plane" size="0 0 1"/> to <worldbody>'
        raise UserError(f"{scene.name}: imitation by a free root needs a floor: {remedy}")
    if first_q and robot.tracked[:1] != scene.body_names[:1]:
        raise UserError(f"{scene.name}: the first tracked body has to be the root, {scene.body_names[0]!r}")
    for name in (robot.anchor, *robot.ends):
        if name not in robot.tracked:
            raise UserError(f"{scene.name}: {name!r} is not among the tracked bodies: add it there")
    for name in robot.posture:
        if name not in scene.joint_names:
            raise UserError(f"{scene.name} has no joint {name!r}: {did_you_mean(name, scene.joint_names)}")


def ground(scene: Scene) -> np.ndarray:
    """Which contact candidates (ncontact,) are with the floor or another part of the world, not of two links."""
    core = scene.core
    return np.asarray((core.con_plane >= 0) | (core.con_bodyA < 0) | (core.con_bodyB < 0))


def clearance(scene: Scene, q: np.ndarray) -> np.ndarray:
    """The least gap [m] (...,) of q (..., nq) from the floor; infinite where the scene has none."""
    return np.asarray(scene.gaps(q)[..., ground(scene)].min(axis=-1, initial=math.inf))


def driven(scene: Scene) -> np.ndarray:
    """Which joints after the root (joints,) have a servo of their own."""
    return np.isin(np.arange(root(scene)[1], scene.nv), scene.core.act_line)


def lengths(scene: Scene, q: np.ndarray) -> np.ndarray:
    """What each actuator's servo measures (F, nu) at q (F, nq): its joint's position, or the length of its tendon."""
    model, line = ComplementarityModel(scene), np.array(scene.core.act_line)
    measured = model.smooth_dynamics(q, np.zeros((len(q), scene.nv)), contacts=False)["length"]
    return np.asarray(measured[:, line])


def controls_per_length(scene: Scene) -> Tensor:
    """By what the target of each actuator (nu,) is its control."""
    return torch.tensor([law_of(scene, i)[1] for i in range(scene.nu)], dtype=torch.float64)


def reach(scene: Scene, share: float) -> np.ndarray:
    """By how much an action of 1 moves each servo's target [rad or m] (nu,): to ``share`` of its torque limit at rest.

    Without a limit of torque, 0.4, or a fifth of the joint's range where that is less. Never by more than the whole
    range of its targets.
    """
    core, layout = scene.core, scene.layout
    gear, bias = (np.array([core.P[layout.actuator(i, of)] for i in range(scene.nu)]) for of in ("gear", "bias1"))
    joint = core.act_line < scene.nv
    width = np.full(scene.nu, np.inf)
    low, high = (x.numpy() for x in soft_limits(scene, 1.0))
    width[joint] = (high - low)[core.act_line[joint] - root(scene)[1]]
    targets = np.ptp(np.reshape(core.act_ctrl, (-1, 2)), axis=1) / np.abs(controls_per_length(scene).numpy())
    limited = share * (strongest(scene) / (-bias * gear**2))
    free = np.minimum(FREE_REACH, FREE_SHARE * np.minimum(width, targets))
    return np.minimum(np.where(np.isfinite(limited), limited, free), targets)


def noise(scene: Scene, hinge: float) -> np.ndarray:
    """Half-widths (joints,) of a start's noise: ``hinge`` [rad], as much of a slide's range; 0 without a servo."""
    low, high = (x.numpy() for x in soft_limits(scene, 1.0))
    slide = np.array([kind == "position" for kind in scene.coordinate_kinds[root(scene)[1] :]])
    width = np.where(slide, hinge * np.where(np.isfinite(high - low), high - low, 0.0), hinge)
    return np.where(driven(scene), width, 0.0)


def size(scene: Scene, anchor: str) -> float:
    """How large the robot is, as a share of :data:`SIZE`, at most 1: by its farthest body in the file's first pose."""
    places = scene.body_poses(scene.q0)[0]
    centre = scene.body_names.index(anchor) if anchor in scene.body_names else 0
    return min(1.0, float(np.linalg.norm(places - places[centre], axis=1).max()) / SIZE)


def soft_limits(scene: Scene, share: float) -> tuple[Tensor, Tensor]:
    """The middle ``share`` of each joint's range, low and high (joints,); infinite where a joint has none."""
    low, high, core = np.full(scene.nq, -np.inf), np.full(scene.nq, np.inf), scene.core
    joint = (core.lim_line < scene.nv) & (core.lim_ball < 0)
    places = kinematics.addresses(core)[core.lim_line[joint]]
    least, most = core.lim_lo[joint], core.lim_hi[joint]
    middle, half = (least + most) / 2, share * (most - least) / 2
    low[places], high[places] = middle - half, middle + half
    first = root(scene)[0]
    return torch.from_numpy(low[first:]), torch.from_numpy(high[first:])
