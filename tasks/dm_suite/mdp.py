"""Observation, reward and reset of the DeepMind Control Suite's walker and cheetah (dm_control/suite).

Episodes last 1,000 control steps of 25 and 10 ms and never end earlier; a step earns 0 to 1.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from cmbrl.data.recorder import without_mujoco_warnings
from cmbrl.mdp import MDP, never
from cmbrl.models.body_motion import BodyMotion, BodyMotions
from cmbrl.scene import Scene

STAND_HEIGHT, WALKER_SPEED, CHEETAH_SPEED = 1.2, 8.0, 10.0  # m, m/s
SETTLE = 200  # steps of MuJoCo by which the suite's cheetah falls to the floor before an episode


class Planar:
    """A robot of the suite: its file, and how its bodies move."""

    def __init__(self, path: Path) -> None:
        with without_mujoco_warnings():
            self.file = mujoco.MjModel.from_xml_path(str(path))
        names = [self.file.body(k).name for k in range(1, self.file.nbody)]
        self.bodies = BodyMotions(Scene.from_mjcf(path, reduce=False), names)
        self.share = torch.from_numpy(self.file.body_mass[1:] / self.file.body_mass[1:].sum())
        self.centre = torch.from_numpy(self.file.body_ipos[1:].copy())
        self.low, self.high = torch.from_numpy(self.file.jnt_range.T.copy())
        self.limited = torch.from_numpy(self.file.jnt_limited.astype(bool))
        self.turns = torch.from_numpy(self.file.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)

    def speed(self, moving: BodyMotion) -> Tensor:
        """(B,): velocity of the centre of mass along x [m/s]."""
        arm = moving.rotation @ self.centre[:, :, None]
        linear = moving.linear + torch.linalg.cross(moving.angular, arm[..., 0], dim=-1)
        return linear[..., 0] @ self.share

    def anywhere(self, count: int, generator: torch.Generator, free: float) -> Tensor:
        """(B, nq): limited joints uniformly within their limits, other hinges within +-``free`` [rad], the rest 0."""
        share = torch.rand(count, self.file.nq, generator=generator, dtype=torch.float64)
        angle = torch.where(self.turns, free * (2 * share - 1), 0.0)
        return torch.where(self.limited, self.low + share * (self.high - self.low), angle)


def at_least(x: Tensor, bound: float, margin: float, value: float, linear: bool) -> Tensor:
    """(B,): 1 where x (B,) is at least ``bound``, less below it, ``value`` a ``margin`` below: linear or Gaussian."""
    short = (bound - x).clamp(min=0.0) / margin
    if linear:
        return (1.0 - (1.0 - value) * short).clamp(min=0.0)
    return torch.exp(math.log(value) * short.square())


def walker_run(path: Path) -> MDP:
    """The walker that runs at 8 m/s, from random joint angles."""
    robot = Planar(path)

    def observe(q: Tensor, v: Tensor) -> Tensor:
        moving = robot.bodies(q, v)
        turned = moving.rotation[:, :, 0][..., [0, 2]].flatten(1)
        return torch.cat([turned, moving.position[:, :1, 2], v], dim=1)

    def reward(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
        moving = robot.bodies(q_next, v_next)
        standing = at_least(moving.position[:, 0, 2], STAND_HEIGHT, STAND_HEIGHT / 2, 0.1, linear=False)
        upright = (1.0 + moving.rotation[:, 0, 2, 2]) / 2.0
        running = at_least(robot.speed(moving), WALKER_SPEED, WALKER_SPEED / 2, 0.5, linear=True)
        return (3.0 * standing + upright) / 4.0 * (5.0 * running + 1.0) / 6.0

    def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        q = robot.anywhere(count, generator, free=math.pi)
        return q, torch.zeros(count, robot.file.nv, dtype=torch.float64)

    return MDP(
        observations=2 * (robot.file.nbody - 1) + 1 + robot.file.nv, actions=robot.file.nu, observe=observe,
        reward=reward, terminated=never, reset=reset, dt=0.025, episode_steps=1000,
    )  # fmt: skip


def cheetah_run(path: Path) -> MDP:
    """The half-cheetah that runs at 10 m/s, from random joint angles after a fall to the floor."""
    robot = Planar(path)

    def observe(q: Tensor, v: Tensor) -> Tensor:
        return torch.cat([q[:, 1:], v], dim=1)

    def reward(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
        return at_least(robot.speed(robot.bodies(q_next, v_next)), CHEETAH_SPEED, CHEETAH_SPEED, 0.0, linear=True)

    def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        return _settled(robot.file, robot.anywhere(count, generator, free=0.0))

    return MDP(
        observations=robot.file.nq - 1 + robot.file.nv, actions=robot.file.nu, observe=observe,
        reward=reward, terminated=never, reset=reset, dt=0.01, episode_steps=1000,
    )  # fmt: skip


def _settled(file: Any, q: Tensor) -> tuple[Tensor, Tensor]:
    """States (B, nq), (B, nv) into which q (B, nq) falls without controls."""
    data = mujoco.MjData(file)
    found = []
    for row in q.numpy():
        mujoco.mj_resetData(file, data)
        data.qpos[:] = row
        mujoco.mj_step(file, data, nstep=SETTLE)
        found.append(np.concatenate([data.qpos, data.qvel]))
    q_, v_ = torch.from_numpy(np.array(found).reshape(-1, file.nq + file.nv)).split([file.nq, file.nv], dim=1)
    return q_, v_
