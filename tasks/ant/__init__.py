"""Ant: a torso on four legs, in space; the real system is Gymnasium's Ant-v5 (MuJoCo, 5 RK4 steps of 10 ms).

Policies observe its state without contact forces; the reward is Ant-v5's in the real system: see mdp.py.
"""

from __future__ import annotations

from typing import Any

from cmbrl.tasks.gymnasium_robot import robot_task


def _feel(model: Any, data: Any) -> Any:
    from cmbrl.tasks.ant.mdp import feel_real

    return feel_real(model, data)


TASK = robot_task(
    "ant",
    "Ant-v5",
    "ant.xml",
    frame_skip=5,
    recorded_steps=200,
    options={"include_cfrc_ext_in_observation": False},
    feel=_feel,
    description="Ant-v5: four legs, 8 motors; episodes end when it is too low or too high",
    control_dt=0.05,
    substeps=10,
    time_step=0.005,
    integrator="semi-implicit",
    sliding="convex",
    contact_gap=1e-2,
)
