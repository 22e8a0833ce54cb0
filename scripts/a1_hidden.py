"""A Unitree A1 that walks, whose real system is MuJoCo with other physics: a task file, for docs/results/README.md.

A1=FOLDER/unitree_a1/scene.xml DRAW=1 cmbrl record scripts/a1_hidden.py --steps 2000 --seed 5 --out log.npz
... cmbrl fit scripts/a1_hidden.py --data log.npz --out fit --groups mass --groups com_x --groups kp --groups damping \
        --groups frictionloss --groups friction
... cmbrl train scripts/a1_hidden.py --algorithm shac --model fit --iterations 400 --out run     # or --model nominal
... cmbrl evaluate run --real --episodes 5
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.walking import Walker, walking_task

LEGS = ("FR", "FL", "RR", "RL")
POSTURE = {f"{leg}_{joint}_joint": x for leg in LEGS for joint, x in (("thigh", 0.9), ("calf", -1.8))}


def change(model: Any) -> None:
    """The physics of draw number DRAW."""
    rng = np.random.default_rng(int(os.environ.get("DRAW", "0")))
    scale = rng.uniform(0.8, 1.2, model.nbody)
    model.body_mass *= scale
    model.body_inertia *= scale[:, None]
    load, ahead = rng.uniform(2, 5), rng.uniform(-0.15, 0.15)  # kg and m, in the trunk
    mass = model.body_mass[1]
    model.body_ipos[1] = (mass * model.body_ipos[1] + load * np.array([ahead, 0, 0.05])) / (mass + load)
    model.body_mass[1] += load
    gain = rng.uniform(0.45, 0.8)
    model.actuator_gainprm[:, 0] *= gain
    model.actuator_biasprm[:, 1] *= gain
    model.dof_frictionloss[6:] = rng.uniform(0.1, 0.8)
    model.dof_damping[6:] *= rng.uniform(0.5, 1.5)
    model.geom_friction[:, 0] = rng.uniform(0.4, 0.8)


WALKER = Walker(scene=Path(os.environ.get("A1", "a1.xml")).resolve(), posture=POSTURE)
TASK = walking_task("a1_hidden", "A1 with other physics", WALKER, change=change)
