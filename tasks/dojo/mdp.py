"""The decision processes of Dojo's hopper and half-cheetah (v0.1.0), after its sources and scripts.

Actions are limited to [-1, 1] here (unbounded there), and rewards are not clipped to [-1, 1] in training. Episodes last
80 steps of 50 ms, as in its training scripts for the half-cheetah.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cmbrl.mdp import MDP, inside, never, uniform
from cmbrl.tasks.hopper.mdp import SAFE_HEIGHT, SAFE_PITCH
from cmbrl.tasks.running import barrier

DT, STEPS = 0.05, 80  # s, steps of an episode
HEIGHT, LOW, PITCH, STATE = 1.25, 0.7, 0.2, 100.0  # m, m, rad, both: start; healthy above, within, within
REST_HEIGHT, REST_PITCH, DROP = 0.576509, 0.02792, 0.1  # m, rad, m

BOTTOM = torch.tensor([-STATE, LOW, -PITCH, *9 * [-STATE]], dtype=torch.float64)  # of a healthy hopper's (q, v)
TOP = torch.tensor([STATE, STATE, PITCH, *9 * [STATE]], dtype=torch.float64)


def hopper_observation(q: Tensor, v: Tensor) -> Tensor:
    """(B, 11): all of q but x, velocities clipped at +-10."""
    return torch.cat([q[:, 1:], v.clamp(-10.0, 10.0)], dim=1)


def hopper_reward(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
    """(B,): forward speed of the torso [m/s], plus 0.1, minus 1e-4 |action|^2."""
    return v_next[:, 0] + 0.1 - 1e-4 * action.square().sum(dim=1)


def hopper_fell(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: too low or too tilted, or any state out of bounds or not finite."""
    return ~inside(q, v, BOTTOM, TOP)


def hopper_reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """States upright and at rest with the foot 4 cm above the floor, each coordinate and velocity off by up to 5e-3."""
    q = uniform(count, 6, 5e-3, generator)
    q[:, 1] += HEIGHT
    return q, uniform(count, 6, 5e-3, generator)


def cheetah_observation(q: Tensor, v: Tensor) -> Tensor:
    """(B, 18): the whole state."""
    return torch.cat([q, v], dim=1)


def cheetah_reward(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
    """(B,): forward speed of the torso [m/s], minus 0.1 |action|^2."""
    return v_next[:, 0] - 0.1 * action.square().sum(dim=1)


def cheetah_reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """States near the rest posture, each coordinate and velocity off by up to 0.1, lifted by 0.1 m.

    The lift is ours: without it, half of the feet would start inside the floor.
    """
    q = uniform(count, 9, 0.1, generator)
    q[:, 1] += REST_HEIGHT + DROP
    q[:, 2] += REST_PITCH
    return q, uniform(count, 9, 0.1, generator)


def hopper() -> MDP:
    """Dojo's hopper."""
    return MDP(
        observations=11, actions=3, observe=hopper_observation, reward=hopper_reward, terminated=hopper_fell,
        reset=hopper_reset, dt=DT, episode_steps=STEPS, shaping=barrier(SAFE_HEIGHT, SAFE_PITCH),
    )  # fmt: skip


def cheetah() -> MDP:
    """Dojo's half-cheetah; never terminates."""
    return MDP(
        observations=18, actions=6, observe=cheetah_observation, reward=cheetah_reward, terminated=never,
        reset=cheetah_reset, dt=DT, episode_steps=STEPS,
    )  # fmt: skip
