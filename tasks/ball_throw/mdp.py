"""Throwing the ball at a goal: one step of the process is a whole throw, and its action the launch velocity.

The ball throw of the ABS paper (Zhang, Jin, Wang, ICML 2023) has a contact before the goal. Its constants are not
published, so these are ours. In each variant the goal can only be reached after contact, and gradient descent from the
middle of the action's range meets a cliff, a plateau, or both.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from cmbrl.mdp import MDP, uniform

STEP = 0.01  # s, of the model
SPREAD = 0.02  # m, largest deviation of a throw's start


@dataclass(frozen=True)
class Throw:
    """Start [m], goal [m], range of the launch speed along x and along z [m/s], and duration [s]."""

    start: tuple[float, float]
    goal: tuple[float, float]
    speed_x: tuple[float, float]
    speed_z: tuple[float, float]
    duration: float


# Off the ground and off the wall, back to the goal. Thrown too low, the ball leaps over the wall instead: a cliff.
BANK = Throw(start=(-0.6, 0.7), goal=(-0.59, 0.5), speed_x=(3.0, 8.0), speed_z=(-6.0, -1.0), duration=0.8)
# It does not bounce, and slides until it rolls. Thrown too fast, it always ends at the wall: a plateau.
SLIDE = Throw(start=(-1.2, 0.7), goal=(0.4, 0.1), speed_x=(1.0, 7.0), speed_z=(-3.0, 0.0), duration=1.0)
# Off the ground and over the wall. Slightly lower, the ball hits the wall's edge and ends elsewhere, or before it.
OVER = Throw(start=(-0.8, 0.7), goal=(1.6, 0.5), speed_x=(1.5, 4.5), speed_z=(-5.5, -2.5), duration=0.8)


def mdp(throw: Throw) -> MDP:
    """Reward: minus the squared distance to the goal [m^2] at the end; ``info`` has the distance [m]."""
    goal = torch.tensor(throw.goal, dtype=torch.float64)
    low, high = torch.tensor([throw.speed_x, throw.speed_z], dtype=torch.float64).T

    def launch(q: Tensor, v: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        speed = low + (high - low) * (action + 1) / 2
        return q, torch.cat([speed, torch.zeros_like(speed[:, :1])], dim=1), q.new_empty(len(q), 0)

    def reward(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> Tensor:
        return -(q_next[:, :2] - goal).square().sum(dim=1)

    def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
        return {"distance": (q_next[:, :2] - goal).norm(dim=1)}

    def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        place = torch.tensor((*throw.start, 0.0), dtype=torch.float64).repeat(count, 1)
        place[:, :2] += uniform(count, 2, SPREAD, generator)
        return place, torch.zeros_like(place)

    return MDP(
        observations=6, actions=2, observe=observe, reward=reward, terminated=landed, reset=reset,
        dt=throw.duration, episode_steps=1, act=launch, repeat=round(throw.duration / STEP), info=info,
    )  # fmt: skip


def observe(q: Tensor, v: Tensor) -> Tensor:
    """(B, 6): position, spin angle and their rates."""
    return torch.cat([q, v], dim=1)


def landed(q: Tensor, v: Tensor) -> Tensor:
    """(B,) bool: every throw ends its episode."""
    return torch.ones(len(q), dtype=torch.bool)
