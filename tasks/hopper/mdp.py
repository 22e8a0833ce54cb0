"""Hopper-v5's observation, reward, termination and reset (Gymnasium 1.x, gymnasium/envs/mujoco/hopper_v5.py).

q = (x, z, pitch, thigh, leg, foot), v its rates; z starts at 1.25 m.
"""

from __future__ import annotations

from math import inf

import torch
from torch import Tensor

from cmbrl.mdp import MDP, inside, uniform
from cmbrl.tasks.running import barrier, observe_clipped, reward

DT = 0.008  # s
START = (0.0, 1.25, 0.0, 0.0, 0.0, 0.0)
LOW, PITCH, STATE = 0.7, 0.2, 100.0  # m, rad, both: healthy above, within, within
SAFE_HEIGHT, SAFE_PITCH = 0.95, 0.12  # of the training barrier; hoppers end by height more often than by pitch

BOTTOM = torch.tensor([-inf, LOW, -PITCH, *9 * [-STATE]], dtype=torch.float64)  # of a healthy (q, v)
TOP = torch.tensor([inf, inf, PITCH, *9 * [STATE]], dtype=torch.float64)


def healthy(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: upright enough to continue; false for a state that is not finite."""
    return inside(q, v, BOTTOM, TOP)


def terminated(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: the hopper has fallen."""
    return ~healthy(q, v)


def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """States at rest and upright, each coordinate and velocity off by up to 5e-3."""
    start = torch.tensor(START, dtype=torch.float64)
    return start + uniform(count, 6, 5e-3, generator), uniform(count, 6, 5e-3, generator)


REWARD = reward(DT, 1e-3, healthy)


def mdp() -> MDP:
    """Hopper-v5."""
    return MDP(
        observations=11, actions=3, observe=observe_clipped, reward=REWARD, terminated=terminated, reset=reset,
        dt=DT, episode_steps=1000, shaping=barrier(SAFE_HEIGHT, SAFE_PITCH), info=REWARD.info,
    )  # fmt: skip
