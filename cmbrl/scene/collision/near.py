"""Which parts of one robot come near each other: what MuJoCo's collision detection finds in random poses."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain

import mujoco
import numpy as np

from cmbrl.scene.collision.shapes import Shape
from cmbrl.scene.records import Frame

POSES = 400
NEAR = 0.02  # m
_DEEPER = 0.005  # m
_FEW, _FALSE = 40, 0.2  # poses in which stand-ins are tried; share of them in which they may touch in vain
_UNBOUNDED = 100.0  # m, rad
_TYPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
CHOICES = ("near", "all", "none")


def false_pairs(model: mujoco.MjModel, shapes: Mapping[int, Shape], frames: Sequence[Frame]) -> set[tuple[int, int]]:
    """Pairs of geoms, sorted, whose stand-ins (``shapes``, by geom) touch in a fifth of all poses where they do not.

    Or are 5 mm deeper in each other. Such a pair would push all the time. And pairs of one robot for which that is so
    where it starts, in the initial pose or a keyframe: they would push it away from there.
    """
    probe = copy.copy(model)
    for geom, shape in shapes.items():
        frame = frames[model.geom_bodyid[geom]]
        probe.geom_type[geom] = _TYPES[shape.kind]
        probe.geom_dataid[geom] = -1
        probe.geom_size[geom] = shape.size
        probe.geom_pos[geom] = frame.rot.T @ (shape.pos - frame.pos)
        mujoco.mju_mat2Quat(probe.geom_quat[geom], np.ravel(frame.rot.T @ shape.rot))
        probe.geom_rbound[geom] = shape.bound
        probe.geom_aabb[geom] = [0.0, 0.0, 0.0, *[shape.bound] * 3]
        probe.geom_sameframe[geom] = 0
    probe.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    tried = poses(model, _FEW)
    theirs, ours = _touching(model, tried), _touching(probe, tried)
    false = [
        {pair for pair, depth in stood_in.items() if depth < true.get(pair, _DEEPER) - _DEEPER}
        for true, stood_in in zip(theirs, ours, strict=True)
    ]
    often = {pair for pair, times in Counter(chain(*false)).items() if times > _FALSE * len(tried)}
    at_start = set().union(*false[: 1 + model.nkey])
    root = model.body_rootid[model.geom_bodyid]
    return often | {(a, b) for a, b in at_start if root[a] == root[b] != 0}


def near_pairs(model: mujoco.MjModel) -> set[tuple[int, int]]:
    """Pairs of geoms, sorted, that are closer than 2 cm in the initial pose, a keyframe, or one of 400 random ones.

    Joints with limits are drawn between them, others over a turn or within 1 m. Roots stay where they are.
    """
    probe = copy.copy(model)
    probe.geom_margin[:] = NEAR
    probe.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return set().union(*_touching(probe, poses(model, POSES)))


def poses(model: mujoco.MjModel, count: int) -> list[np.ndarray]:
    """The initial pose, those of keyframes, and ``count`` random ones."""
    rng = np.random.default_rng(0)
    return [model.qpos0, *model.key_qpos, *(_random_pose(model, rng) for _ in range(count))]


def _touching(model: mujoco.MjModel, poses: Sequence[np.ndarray]) -> list[dict[tuple[int, int], float]]:
    return [near for _, near in touching(model, poses)]


def touching(
    model: mujoco.MjModel, poses: Iterable[np.ndarray]
) -> Iterator[tuple[mujoco.MjData, dict[tuple[int, int], float]]]:
    """MuJoCo's data at each of the ``poses``, the same object, with pairs of geoms within their margin there.

    Pairs are sorted, with their distance [m].
    """
    data = mujoco.MjData(model)
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        near: dict[tuple[int, int], float] = {}
        for pair, distance in zip(data.contact.geom.tolist(), data.contact.dist.tolist(), strict=True):
            key = min(pair), max(pair)
            near[key] = min(distance, near.get(key, distance))
        yield data, near


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
            if high - low > _UNBOUNDED:  # limits that are meant as none
                low, high = np.clip((low, high), q[at] - free, q[at] + free)
            q[at] = rng.uniform(low, high)
    return q
