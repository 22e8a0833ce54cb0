"""A floating base that is held hangs in the air: so high that nothing of it reaches the ground of the file.

The initial pose of many files is that of a robot that stands, and legs that swing freely would be in the floor there.
Under gravity alone nothing else depends on the height.
"""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np

_CLEAR = 0.05  # [m] that is left under the lowest point that anything may reach
_LEVEL = 0.7  # of the ground's normal along the vertical; what is steeper is a wall
_FREE, _SLIDE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_GROUNDS = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))


def lifts(model: mujoco.MjModel, joints: Collection[str]) -> dict[str, np.ndarray]:
    """By body, the way up (3,) [m] that puts bases on the free ones of ``joints`` out of reach of the ground."""
    gravity = np.array(model.opt.gravity)
    if not gravity.any():
        return {}
    up, data = -gravity / np.linalg.norm(gravity), mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found: dict[str, np.ndarray] = {}
    for joint in (model.joint(name) for name in joints):
        base = int(joint.bodyid[0])
        ways = [_way_up(model, data, ground, base, up) for ground in _grounds(model)] if joint.type[0] == _FREE else []
        if (most := max(ways, default=0.0)) > 0.0:
            found[model.body(base).name] = most * up
    return found


def _grounds(model: mujoco.MjModel) -> list[int]:
    """Planes and height fields that do not move and touch something."""
    still = np.isin(model.geom_type, _GROUNDS) & (model.body_weldid[model.geom_bodyid] == 0)
    return np.flatnonzero(still & ((model.geom_contype | model.geom_conaffinity) != 0)).tolist()


def _way_up(model: mujoco.MjModel, data: mujoco.MjData, ground: int, base: int, up: np.ndarray) -> float:
    """How far ``base`` has to go ``up`` to be out of reach of a ground; below 0 where it is, or that is a wall."""
    normal = data.geom_xmat[ground].reshape(3, 3)[:, 2]
    if (rise := float(normal @ up)) < _LEVEL:
        return -1.0
    top = model.hfield_size[model.geom_dataid[ground], 2] if model.geom_type[ground] == _GROUNDS[1] else 0.0
    height = float(normal @ (data.xpos[base] - data.geom_xpos[ground])) - top
    return (_reach(model, base) + _CLEAR - height) / rise


def _reach(model: mujoco.MjModel, base: int) -> float:
    """A distance [m] from the origin of ``base`` beyond which nothing that hangs on it gets, in any pose."""
    reach = {base: 0.0}
    for body in range(base + 1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent in reach:
            own = slice(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
            slides = np.abs(model.jnt_range[own][model.jnt_type[own] == _SLIDE]).max(axis=1, initial=0.0)
            anchors = 2.0 * np.linalg.norm(model.jnt_pos[own], axis=1)
            reach[body] = reach[parent] + float(np.linalg.norm(model.body_pos[body]) + anchors.sum() + slides.sum())
    shapes = [geom for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in reach]
    ends = [
        reach[int(model.geom_bodyid[k])] + float(np.linalg.norm(model.geom_pos[k]) + model.geom_rbound[k])
        for k in shapes
    ]
    return max(ends, default=0.0)
