"""Robots of MuJoCo Menagerie that walk: a task file, for docs/results/robots.md.

SCENE=FOLDER/unitree_g1/scene.xml ROBOT=g1 cmbrl train scripts/walkers.py --algorithm shac --model nominal \
        --iterations 400 --out runs/g1
... cmbrl evaluate runs/g1 --real --episodes 5

The same robots with other physics than that of their files, drawn by the number DRAW:

SCENE=... ROBOT=a1 DRAW=1 cmbrl record scripts/walkers.py --steps 2000 --seed 5 --out log.npz
... cmbrl fit scripts/walkers.py --data log.npz --out fit
... cmbrl train scripts/walkers.py --algorithm shac --model fit --iterations 400 --out run     # or --model nominal
... cmbrl evaluate run --real --episodes 5
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.scene.drives import Drive
from cmbrl.walking import Walker, walking_task


def alike(pattern: str, parts: tuple[str, ...], angles: dict[str, float]) -> dict[str, float]:
    """The same angles [rad] in every leg: names by ``pattern``, of a part of the robot and a joint."""
    return {pattern.format(part, joint): angle for part in parts for joint, angle in angles.items()}


SIDES = ("left", "right")
UNITREE = alike("{}_{}_joint", ("FR", "FL", "RR", "RL"), {"thigh": 0.9, "calf": -1.8})
ANYMAL = alike("{}_{}", ("LF", "RF"), {"HFE": 0.6, "KFE": -1.2}) | alike(
    "{}_{}", ("LH", "RH"), {"HFE": -0.6, "KFE": 1.2}
)
BARKOUR = {f"{joint}_{end}_{side}": x for joint, x in (("hip", 0.5), ("knee", 1.0))
           for end in ("front", "hind") for side in SIDES}  # fmt: skip
G1 = alike("{}_{}_joint", SIDES, {"hip_pitch": -0.3, "knee": 0.65, "ankle_pitch": -0.35, "elbow": 1.0})
G1 |= {"left_shoulder_roll_joint": 0.3, "right_shoulder_roll_joint": -0.3}
TALOS = alike("leg_{}_{}_joint", SIDES, {"3": -0.4, "4": 0.8, "5": -0.4}) | alike("arm_{}_{}_joint", SIDES, {"4": -1.0})
TALOS_DRIVES = (
    Drive("*", "position", kp=200.0, kd=5.0),
    Drive("leg_*", "position", kp=1000.0, kd=30.0),
    Drive("torso*", "position", kp=500.0, kd=20.0),
)

ROBOTS = {  # posture [rad], speed ahead [m/s], drives
    "a1": (UNITREE, 0.8, ()),
    "go2": (UNITREE, 0.8, ()),
    "spot": (alike("{}_{}", ("fl", "fr", "hl", "hr"), {"hy": 0.9, "kn": -1.6}), 0.8, ()),
    "anymal": (ANYMAL, 0.6, ()),
    "barkour": (BARKOUR, 0.6, ()),
    "apollo": (alike("{}_{}", ("l", "r"), {"hip_fe": -0.4, "knee_fe": 0.8, "ankle_pd": -0.4}), 0.6, ()),
    "g1": (G1, 0.6, ()),
    "talos": (TALOS, 0.5, TALOS_DRIVES),
}


def hidden(model: Any) -> None:
    """Changes MuJoCo's ``model`` to the physics of draw number DRAW."""
    rng = np.random.default_rng(int(os.environ["DRAW"]))
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


NAME = os.environ.get("ROBOT", "a1")
POSTURE, SPEED, DRIVES = ROBOTS[NAME]
SCENE = Path(os.environ.get("SCENE", "scene.xml")).resolve()
WALKER = Walker(scene=SCENE, posture=POSTURE, speed=(SPEED, 0.0, 0.0), drives=DRIVES)
TASK = (
    walking_task(f"{NAME}_hidden", f"{NAME} with other physics", WALKER, change=hidden)
    if "DRAW" in os.environ
    else walking_task(f"{NAME}_walks", f"{NAME} of MuJoCo Menagerie, walking", WALKER)
)
