"""Ant-v5's reward, termination and reset (Gymnasium 1.x, gymnasium/envs/mujoco/ant_v5.py), and its state as observed.

q = (position, quaternion w x y z, hip and ankle of each leg), v its velocity; the torso starts at 0.75 m.

Three things are of MuJoCo's last step rather than of the state, and kept in the process's memory: the torso's x and y,
which Gymnasium takes from its last evaluation (1e-4 m off the state's), and the cost of contact forces. Only the
real system tells them. In the model x and y are the state's, and the cost is 0, because the core does not tell the
wrenches on bodies. It is at most 0.0005 for each of six numbers of a body: 1e-3 to 1e-2 of a reward of 1 to 8 a step.

For the same reason policies do not observe contact forces: observations are those of Gymnasium's Ant-v5 with
``include_cfrc_ext_in_observation=False``, which is Ant-v4's default.
"""

from __future__ import annotations

from math import inf, nextafter
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.mdp import MDP, Total, inside, uniform

DT = 0.05  # s
NQ, NV, FELT = 15, 14, 3
START = (0.0, 0.0, 0.75, 1.0, *11 * [0.0])
LOW, HIGH = 0.2, 1.0  # m, both included: healthy between
NOISE = 0.1  # of resets
QUATERNION = slice(3, 7)
UNIT = 1e-9  # a quaternion this near to unit length is one

BOTTOM = torch.tensor([-inf, -inf, nextafter(LOW, 0.0), *26 * [-inf]], dtype=torch.float64)  # of a healthy (q, v)
TOP = torch.tensor([inf, inf, nextafter(HIGH, 2.0), *26 * [inf]], dtype=torch.float64)


def feel_real(model: Any, data: Any) -> np.ndarray:
    """(3,): x and y of the torso as of the last evaluation of MuJoCo, and the cost of the forces on bodies."""
    import mujoco

    mujoco.mj_rnePostConstraint(model, data)  # MuJoCo itself leaves cfrc_ext to whoever asks
    cost = 5e-4 * np.square(np.clip(data.cfrc_ext, -1.0, 1.0)).sum()
    return np.array([*data.xpos[1, :2], cost])


def feel(q: Tensor, v: Tensor) -> Tensor:
    """(B, 3) in the model: the state's x and y, no cost."""
    return torch.cat([q[:, :2], torch.zeros_like(q[:, :1])], dim=1)


def observe(q: Tensor, v: Tensor) -> Tensor:
    """(B, 27): the state without x and y."""
    return torch.cat([q[:, 2:NQ], v], dim=1)


def act(q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The step starts from a unit quaternion, which a reset's is not: MuJoCo's first step makes it one."""
    length = q[:, QUATERNION].norm(dim=1, keepdim=True)
    if bool(((length - 1.0).abs() <= UNIT).all()):
        return q, v, action
    turned = torch.where((length - 1.0).abs() <= UNIT, q[:, QUATERNION], q[:, QUATERNION] / length)
    return torch.cat([q[:, : QUATERNION.start], turned, q[:, QUATERNION.stop :]], dim=1), v, action


def healthy(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: neither too low nor too high; false for a state that is not finite."""
    return inside(q[:, :NQ], v, BOTTOM, TOP)


def terminated(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: the ant has left the healthy heights."""
    return ~healthy(q, v)


def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
    """What Gymnasium's Ant-v5 reports of a step, by name (B,): place [m], speeds [m/s], and parts of the reward.

    They are 1 while healthy, the forward speed, the control cost -0.5 |action|^2, and the contact cost.
    """
    speed = (q_next[:, NQ : NQ + 2] - q[:, NQ : NQ + 2]) / DT
    return {
        "x_position": q_next[:, 0],
        "y_position": q_next[:, 1],
        "x_velocity": speed[:, 0],
        "y_velocity": speed[:, 1],
        "reward_survive": healthy(q_next, v_next).double(),
        "reward_forward": speed[:, 0],
        "reward_ctrl": -0.5 * action.square().sum(dim=1),
        "reward_contact": -q_next[:, NQ + 2],
    }


REWARD = Total(info, ("reward_survive", "reward_forward", "reward_ctrl", "reward_contact"))


def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Coordinates off by up to 0.1, the quaternion's too; velocities by a standard deviation of 0.1."""
    q = torch.tensor(START, dtype=torch.float64) + uniform(count, NQ, NOISE, generator)
    v = NOISE * torch.randn(count, NV, dtype=torch.float64, generator=generator)
    return torch.cat([q, feel(q, v)], dim=1), v


def mdp() -> MDP:
    """Ant-v5."""
    return MDP(
        observations=27, actions=8, observe=observe, reward=REWARD, terminated=terminated, reset=reset, act=act,
        dt=DT, episode_steps=1000, memory=FELT, feel=feel, info=info, failure="falls",
    )  # fmt: skip
