"""Hopper-v5's observation, reward, termination and reset (Gymnasium 1.x, gymnasium/envs/mujoco/hopper_v5.py).

q = (x, z, pitch, thigh, leg, foot), v its rates; z starts at 1.25 m.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cmbrl.mdp import MDP, uniform

DT = 0.008  # s
START = (0.0, 1.25, 0.0, 0.0, 0.0, 0.0)
LOW, PITCH, STATE = 0.7, 0.2, 100.0  # m, rad, both: healthy above, within, within
SAFE_HEIGHT, SAFE_PITCH, SLOPE = 0.95, 0.12, 50.0  # of the training barrier, our choice


def observe(q: Tensor, v: Tensor) -> Tensor:
    """(B, 11): all of q but x, velocities clipped at +-10."""
    return torch.cat([q[:, 1:], v.clamp(-10.0, 10.0)], dim=1)


def healthy(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: upright enough to continue; false for a state that is not finite."""
    bounded = (q[:, 2:].abs() < STATE).all(dim=1) & (v.abs() < STATE).all(dim=1)
    return bounded & (q[:, 1] > LOW) & (q[:, 2].abs() < PITCH)


def terminated(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: the hopper has fallen."""
    return ~healthy(q, v)


def parts(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
    """By name (B,): 1 while healthy, forward speed [m/s], and the control cost -1e-3 |action|^2."""
    return {
        "reward_survive": healthy(q_next, v_next).to(q.dtype),
        "reward_forward": (q_next[:, 0] - q[:, 0]) / DT,
        "reward_ctrl": -1e-3 * action.square().sum(dim=1),
    }


def reward(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
    """(B,): the sum of its parts."""
    alive, forward, price = parts(q, v, action, q_next, v_next).values()
    return alive + forward + price


def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
    """What Gymnasium's Hopper-v5 reports of a step."""
    told = parts(q, v, action, q_next, v_next)
    return {"x_position": q_next[:, 0], "x_velocity": told["reward_forward"], **told}


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
        observations=11, actions=3, observe=observe, reward=reward, terminated=terminated, reset=reset, dt=DT,
        episode_steps=1000, shaping=barrier, info=info,
    )  # fmt: skip
