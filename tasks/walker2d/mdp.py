"""Walker2d-v5's observation, reward, termination and reset (Gymnasium 1.x, gymnasium/envs/mujoco/walker2d_v5.py).

q = (x, z, pitch, thigh, leg, foot, left thigh, leg, foot), v its rates; z starts at 1.25 m.
"""

from __future__ import annotations

from math import inf

import torch
from torch import Tensor

from cmbrl.mdp import MDP, inside, uniform
from cmbrl.tasks.running import barrier, observe_clipped, reward

DT = 0.008  # s
HEIGHT, LOW, HIGH, PITCH = 1.25, 0.8, 2.0, 1.0  # m, m, m, rad: start; healthy above, below, within
SAFE_HEIGHT, SAFE_PITCH = 1.0, 0.6  # of the training barrier: 55 and 60 % of the way to a fall, as the hopper's

BOTTOM = torch.tensor([-inf, LOW, -PITCH, *15 * [-inf]], dtype=torch.float64)  # of a healthy (q, v)
TOP = torch.tensor([inf, HIGH, PITCH, *15 * [inf]], dtype=torch.float64)


def healthy(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: upright enough to continue; false for a state that is not finite."""
    return inside(q, v, BOTTOM, TOP)


def terminated(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: the walker has fallen."""
    return ~healthy(q, v)


def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """States at rest and upright, each coordinate and velocity off by up to 5e-3."""
    q = uniform(count, 9, 5e-3, generator)
    q[:, 1] += HEIGHT
    return q, uniform(count, 9, 5e-3, generator)


REWARD = reward(DT, 1e-3, healthy)


def mdp() -> MDP:
    """Walker2d-v5."""
    return MDP(
        observations=17, actions=6, observe=observe_clipped, reward=REWARD, terminated=terminated, reset=reset,
        dt=DT, episode_steps=1000, shaping=barrier(SAFE_HEIGHT, SAFE_PITCH), info=REWARD.info, failure="falls",
    )  # fmt: skip
