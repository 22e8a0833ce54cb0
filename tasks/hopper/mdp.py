"""Hopper-v5's observation, reward, termination and reset (Gymnasium 1.x, gymnasium/envs/mujoco/hopper_v5.py).

q = (x, z, pitch, thigh, leg, foot), v its rates; z starts at 1.25 m.
"""

from __future__ import annotations

from math import inf

import torch
from torch import Tensor

from cmbrl.mdp import MDP, Total, inside, uniform

DT = 0.008  # s
START = (0.0, 1.25, 0.0, 0.0, 0.0, 0.0)
LOW, PITCH, STATE = 0.7, 0.2, 100.0  # m, rad, both: healthy above, within, within
SAFE_HEIGHT, SAFE_PITCH, SLOPE = 0.95, 0.12, 50.0  # of the training barrier, our choice

BOTTOM = torch.tensor([-inf, LOW, -PITCH, *9 * [-STATE]], dtype=torch.float64)  # of a healthy (q, v)
TOP = torch.tensor([inf, inf, PITCH, *9 * [STATE]], dtype=torch.float64)


def observe(q: Tensor, v: Tensor) -> Tensor:
    """(B, 11): all of q but x, velocities clipped at +-10."""
    return torch.cat([q[:, 1:], v.clamp(-10.0, 10.0)], dim=1)


def healthy(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: upright enough to continue; false for a state that is not finite."""
    return inside(q, v, BOTTOM, TOP)


def terminated(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: the hopper has fallen."""
    return ~healthy(q, v)


def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
    """What Gymnasium's Hopper-v5 reports of a step, by name (B,): x [m], its rate [m/s], and parts of the reward.

    They are 1 while healthy, the forward speed, and the control cost -1e-3 |action|^2.
    """
    x = q_next[:, 0]
    speed = (x - q[:, 0]) / DT
    return {
        "x_position": x,
        "x_velocity": speed,
        "reward_survive": healthy(q_next, v_next).double(),
        "reward_forward": speed,
        "reward_ctrl": -1e-3 * action.square().sum(dim=1),
    }


REWARD = Total(info, ("reward_survive", "reward_forward", "reward_ctrl"))


def barrier(q: Tensor, v: Tensor) -> Tensor:
    """(B,): falls before the hopper is too low or too tilted; hoppers end by height more often than by pitch."""
    return -SLOPE * ((q[:, 2].abs() - SAFE_PITCH).clamp(min=0.0) + (SAFE_HEIGHT - q[:, 1]).clamp(min=0.0))


def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """States at rest and upright, each coordinate and velocity off by up to 5e-3."""
    start = torch.tensor(START, dtype=torch.float64)
    return start + uniform(count, 6, 5e-3, generator), uniform(count, 6, 5e-3, generator)


def mdp() -> MDP:
    """Hopper-v5."""
    return MDP(
        observations=11, actions=3, observe=observe, reward=REWARD, terminated=terminated, reset=reset,
        dt=DT, episode_steps=1000, shaping=barrier, info=info,
    )  # fmt: skip
