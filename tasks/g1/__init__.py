"""Unitree G1: a humanoid with 29 joints that imitates motions; the real system is MuJoCo.

Control at 50 Hz moves the targets of the joints' servos, physics runs at 200 Hz. Without ``--motion`` the robot bends
its knees and steps in place, a motion of our own (`motion.py`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.imitation.robot import Robot, imitation_task

SIDES = ("left", "right")
POSTURE = {
    **{f"{side}_hip_pitch_joint": -0.312 for side in SIDES},
    **{f"{side}_knee_joint": 0.669 for side in SIDES},
    **{f"{side}_ankle_pitch_joint": -0.363 for side in SIDES},
    **{f"{side}_elbow_joint": 0.6 for side in SIDES},
    **{f"{side}_shoulder_pitch_joint": 0.2 for side in SIDES},
    "left_shoulder_roll_joint": 0.2,
    "right_shoulder_roll_joint": -0.2,
}  # rad
LIMBS = ("hip_roll_link", "knee_link", "ankle_roll_link"), ("shoulder_roll_link", "elbow_link", "wrist_yaw_link")
ROBOT = Robot(
    scene=Path(__file__).with_name("scene.xml"),
    tracked=(
        "pelvis",
        *(f"{side}_{link}" for side in SIDES for link in LIMBS[0]),
        "torso_link",
        *(f"{side}_{link}" for side in SIDES for link in LIMBS[1]),
    ),
    anchor="torso_link",
    ends=tuple(f"{side}_{link}" for side in SIDES for link in ("ankle_roll_link", "wrist_yaw_link")),
    posture=POSTURE,
)


def _warm_up(scene: Any) -> Any:
    from cmbrl.tasks.g1.motion import warm_up

    return warm_up(scene, POSTURE)


TASK = imitation_task(
    "g1", "Unitree G1: a humanoid that imitates a motion; its episodes end when it falls", ROBOT, _warm_up
)
