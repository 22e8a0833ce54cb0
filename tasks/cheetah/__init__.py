"""Half-cheetah: a planar runner; the real system is Gymnasium's HalfCheetah-v5 (MuJoCo, 5 Euler steps of 10 ms).

Steps of 10 ms are far from converged in the real system itself, so the model takes the same steps. Random actions never
end an episode; recorded episodes are cut at 200 control steps (10 s), so that small logs can be split by episode.
"""

from __future__ import annotations

from typing import Any

from cmbrl.tasks.gymnasium_robot import robot_task
from cmbrl.tasks.zoo import ARS_CHEETAH, PPO_CHEETAH

EPISODE_STEPS = 200
TRAINING: dict[str, dict[str, Any]] = {
    "shac": {"iterations": 1500},
    "loop": {"iterations": 3000},
    "fopg": {"window": 1.6, "discount": 0.99, "episode_steps": 1000},
    # As its authors have it: 400,000 real steps, rollouts of one step.
    "mbpo": {"iterations": 1580, "updates_per_step": 40, "length_end": 1, "target_entropy": -3.0},
    "ppo": PPO_CHEETAH,
    "ars": ARS_CHEETAH,
}

TASK = robot_task(
    "cheetah",
    "HalfCheetah-v5",
    "half_cheetah.xml",
    frame_skip=5,
    recorded_steps=EPISODE_STEPS,
    description="HalfCheetah-v5: two legs, planar, 6 motors; episodes of 200 control steps",
    control_dt=0.05,
    substeps=5,
    time_step=0.01,
    training=TRAINING,
)
