"""Hopper-v5's observation, reward, termination and reset (Gymnasium 1.x, gymnasium/envs/mujoco/hopper_v5.py).

q = (x, z, pitch, thigh, leg, foot), v its rates; z starts at 1.25 m.
"""

from __future__ import annotations

from math import inf

import torch

from cmbrl.mdp import MDP
from cmbrl.tasks.running import barrier, observe_clipped, reward, upright

DT = 0.008  # s
START = (0.0, 1.25, 0.0, 0.0, 0.0, 0.0)
LOW, PITCH, STATE = 0.7, 0.2, 100.0  # m, rad, both: healthy above, within, within
SAFE_HEIGHT, SAFE_PITCH = 0.95, 0.12  # of the training barrier; hoppers end by height more often than by pitch

BOTTOM = torch.tensor([-inf, LOW, -PITCH, *9 * [-STATE]], dtype=torch.float64)  # of a healthy (q, v)
TOP = torch.tensor([inf, inf, PITCH, *9 * [STATE]], dtype=torch.float64)

healthy, terminated, reset = upright(START, BOTTOM, TOP)
REWARD = reward(DT, 1e-3, healthy)


def mdp() -> MDP:
    """Hopper-v5."""
    return MDP(
        observations=11, actions=3, observe=observe_clipped, reward=REWARD, terminated=terminated, reset=reset,
        dt=DT, episode_steps=1000, shaping=barrier(SAFE_HEIGHT, SAFE_PITCH), info=REWARD.info,
    )  # fmt: skip
