"""Which parts of one robot come near each other: what MuJoCo's collision detection finds in random poses."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

POSES = 400
NEAR = 0.02  # m
CHOICES = ("near", "all", "none")


def near_pairs(model: mujoco.MjModel) -> set[tuple[int, int]]:
    """Pairs of geoms, sorted, that are closer than 2 cm in the initial pose, a keyframe, or one of 400 random ones.

    Joints with limits are drawn between them, others over a turn or within 1 m. Roots stay where they are.
    """
    probe = copy.copy(model)
    probe.geom_margin[:] = NEAR
    probe.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, rng = mujoco.MjData(probe), np.random.default_rng(0)
    poses = [model.qpos0, *model.key_qpos, *(_random_pose(model, rng) for _ in range(POSES))]
    found: set[tuple[int, int]] = set()
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(probe, data)
        mujoco.mj_comPos(probe, data)
        mujoco.mj_collision(probe, data)
        found |= {(min(pair), max(pair)) for pair in data.contact.geom.tolist()}
    return found


def _random_pose(model: mujoco.MjModel, rng: np.random.Generator) -> np.ndarray:
    kinds = mujoco.mjtJoint
    q = model.qpos0.copy()
    for k in range(model.njnt):
        kind, at = int(model.jnt_type[k]), int(model.jnt_qposadr[k])
        if kind == kinds.mjJNT_BALL:
            turn = rng.normal(size=4)
            q[at : at + 4] = turn / np.linalg.norm(turn)
        elif kind in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            free = np.pi if kind == kinds.mjJNT_HINGE else 1.0
            low, high = model.jnt_range[k] if model.jnt_limited[k] else (q[at] - free, q[at] + free)
            q[at] = rng.uniform(low, high)
    return q
