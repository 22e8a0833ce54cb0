"""Hopper: a one-legged planar robot; the real system is Gymnasium's Hopper-v5 (MuJoCo, 4 RK4 steps of 2 ms).

The model takes 4 leapfrog steps of 2 ms: leapfrog is of second order, and MuJoCo's softness maps onto ours only at
MuJoCo's own step (with 2 steps of 4 ms the unfitted model's error doubles).
"""

from __future__ import annotations

from typing import Any

from cmbrl.tasks.gymnasium_robot import robot_task
from cmbrl.tasks.zoo import ARS_HOPPER, PPO_HOPPER

TRAINING: dict[str, dict[str, Any]] = {
    "fopg": {"window": 0.256, "discount": 0.99},
    "mbpo": {"length_end": 15, "target_entropy": -1.0},  # as its authors have it
    "ppo": PPO_HOPPER,
    "ars": ARS_HOPPER,
}

TASK = robot_task(
    "hopper",
    "Hopper-v5",
    "hopper.xml",
    frame_skip=4,
    description="Hopper-v5: one leg, planar, 3 motors; episodes end when it falls",
    control_dt=0.008,
    substeps=4,
    time_step=0.002,
    contact_gap=1e-3,
    training=TRAINING,
)
