"""HalfCheetah-v5's observation, reward and reset (Gymnasium 1.x, gymnasium/envs/mujoco/half_cheetah_v5.py).

q = (x, z, pitch, back thigh, shin, foot, front thigh, shin, foot), v its rates; z = 0 means a torso height of 0.7 m.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cmbrl.mdp import MDP, Total, never, uniform

DT = 0.05  # s


def observe(q: Tensor, v: Tensor) -> Tensor:
    """(B, 17): all of q but x, and the velocities."""
    return torch.cat([q[:, 1:], v], dim=1)


def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
    """What Gymnasium's HalfCheetah-v5 reports of a step, by name (B,): x [m], its rate [m/s], and parts of the reward.

    They are the forward speed and the control cost -0.1 |action|^2.
    """
    x = q_next[:, 0]
    speed = (x - q[:, 0]) / DT
    return {
        "x_position": x,
        "x_velocity": speed,
        "reward_forward": speed,
        "reward_ctrl": -0.1 * action.square().sum(dim=1),
    }


REWARD = Total(info, ("reward_forward", "reward_ctrl"))


def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """States near rest: coordinates off by up to 0.1, velocities by a standard deviation of 0.1."""
    v = 0.1 * torch.randn(count, 9, dtype=torch.float64, generator=generator)
    return uniform(count, 9, 0.1, generator), v


def mdp() -> MDP:
    """HalfCheetah-v5; never terminates."""
    return MDP(
        observations=17, actions=6, observe=observe, reward=REWARD, terminated=never, reset=reset, dt=DT,
        episode_steps=1000, info=info,
    )  # fmt: skip
