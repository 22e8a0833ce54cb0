"""Walker2d-v5's observation, reward, termination and reset (Gymnasium 1.x, gymnasium/envs/mujoco/walker2d_v5.py).

q = (x, z, pitch, thigh, leg, foot, left thigh, leg, foot), v its rates; z starts at 1.25 m.
"""

from __future__ import annotations

from math import inf

import torch

from cmbrl.mdp import MDP
from cmbrl.tasks.running import barrier, observe_clipped, reward, upright

DT = 0.008  # s
START = (0.0, 1.25, *7 * [0.0])
LOW, HIGH, PITCH = 0.8, 2.0, 1.0  # m, m, rad: healthy above, below, within
SAFE_HEIGHT, SAFE_PITCH = 1.0, 0.6  # of the training barrier: 55 and 60 % of the way to a fall, as the hopper's

BOTTOM = torch.tensor([-inf, LOW, -PITCH, *15 * [-inf]], dtype=torch.float64)  # of a healthy (q, v)
TOP = torch.tensor([inf, HIGH, PITCH, *15 * [inf]], dtype=torch.float64)

healthy, terminated, reset = upright(START, BOTTOM, TOP)
REWARD = reward(DT, 1e-3, healthy)


def mdp() -> MDP:
    """Walker2d-v5."""
    return MDP(
        observations=17, actions=6, observe=observe_clipped, reward=REWARD, terminated=terminated, reset=reset,
        dt=DT, episode_steps=1000, shaping=barrier(SAFE_HEIGHT, SAFE_PITCH), info=REWARD.info, failure="falls",
    )  # fmt: skip
