"""HalfCheetah-v5's observation, reward and reset (Gymnasium 1.x, gymnasium/envs/mujoco/half_cheetah_v5.py).

q = (x, z, pitch, back thigh, shin, foot, front thigh, shin, foot), v its rates; z = 0 means a torso height of 0.7 m.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cmbrl.mdp import MDP, never, uniform
from cmbrl.tasks.running import reward

DT = 0.05  # s


def observe(q: Tensor, v: Tensor) -> Tensor:
    """(B, 17): all of q but x, and the velocities."""
    return torch.cat([q[:, 1:], v], dim=1)


def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """States near rest: coordinates off by up to 0.1, velocities by a standard deviation of 0.1."""
    v = 0.1 * torch.randn(count, 9, dtype=torch.float64, generator=generator)
    return uniform(count, 9, 0.1, generator), v


REWARD = reward(DT, 0.1)


def mdp() -> MDP:
    """HalfCheetah-v5; never terminates."""
    return MDP(
        observations=17, actions=6, observe=observe, reward=REWARD, terminated=never, reset=reset, dt=DT,
        episode_steps=1000, info=REWARD.info,
    )  # fmt: skip
