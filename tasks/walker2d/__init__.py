"""Walker2d: a two-legged planar robot; the real system is Gymnasium's Walker2d-v5 (MuJoCo, 4 RK4 steps of 2 ms).

The model takes leapfrog steps of the same length, as the hopper's.
"""

from __future__ import annotations

from typing import Any

from cmbrl.tasks.gymnasium_robot import robot_task

TRAINING: dict[str, dict[str, Any]] = {
    # Its reward hardly charges for torque, and its thighs start at their stops: without this cost one leg is soon held
    # there at full torque, for good, and the walker hops on the other.
    "shac": {"saturation": 0.1},
}

TASK = robot_task(
    "walker2d",
    "Walker2d-v5",
    "walker2d_v5.xml",
    frame_skip=4,
    description="Walker2d-v5: two legs, planar, 6 motors; episodes end when it falls",
    control_dt=0.008,
    substeps=4,
    time_step=0.002,
    sliding="convex",
    contact_gap=1e-3,
    training=TRAINING,
)
