"""A motion of our own for the G1, safe on a robot that is not known well: it bends its knees, then steps in place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cmbrl.imitation.motion import Motion

SIDES = ("left", "right")
RATE, BENDS, STEPS = 50.0, 4.0, 8.0  # frames/s; s of bending, s of stepping
PERIOD = 1.6  # s, of two steps
BEND, SWAY, LIFT = 0.35, 0.12, 0.3  # rad, of hips: at the deepest, of roll while stepping, of the lifted leg


def warm_up(scene: Any, posture: dict[str, float]) -> Motion:
    """Twelve seconds from ``posture`` (angles [rad] by joint, others 0) and back to it."""
    count = round((BENDS + STEPS) * RATE) + 1
    t = np.arange(count) / RATE
    q = np.tile(scene.q0, (count, 1))
    column = {name: 6 + k for k, name in enumerate(scene.joint_names)}  # the root, the first joint, has seven
    for joint, angle in posture.items():
        q[:, column[joint]] = angle
    bend = BEND * (0.5 - 0.5 * np.cos(2 * math.pi * t / (BENDS / 2))) * (t < BENDS)
    phase = 2 * math.pi * (t - BENDS) / PERIOD
    begun = np.clip((t - BENDS) / PERIOD, 0.0, 1.0) * np.clip((BENDS + STEPS - t) / PERIOD, 0.0, 1.0)
    lean = begun * np.sin(phase) * (t >= BENDS)  # to the left above 0
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        q[:, column[f"{side}_hip_roll_joint"]] -= SWAY * lean
        q[:, column[f"{side}_ankle_roll_joint"]] += SWAY * lean
        fold = bend + LIFT * np.clip(-sign * lean, 0.0, None) ** 2
        for joint, share in (("hip_pitch", -1.0), ("knee", 2.0), ("ankle_pitch", -1.0)):
            q[:, column[f"{side}_{joint}_joint"]] += share * fold
    _stand(scene, q)
    return Motion.of_frames(scene, q, RATE, 1 / RATE, "warm-up")


def _stand(scene: Any, q: np.ndarray) -> None:
    """Puts the root of every frame where the feet are on the floor, and the lower one does not slip."""
    q[:, 2] -= scene.gaps(q).min(axis=1)
    feet = [scene.body_names.index(f"{side}_ankle_roll_link") for side in SIDES]
    places = scene.body_poses(q)[0][:, feet]
    lower = places[:, :, 2].argmin(axis=1)
    for k in range(1, len(q)):  # from frame to frame the foot that carries stays where it was
        foot = lower[k]
        slip = places[k, foot, :2] - places[k - 1, foot, :2]
        q[k:, :2] -= slip
        places[k:, :, :2] -= slip
