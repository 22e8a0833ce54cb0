"""Configurations as a manifold: tangent differences and steps in MuJoCo's layout (free joint: world translation, body
rotation; quaternions wxyz), as ``mj_differentiatePos`` and ``mj_integratePos`` define them, over any batch shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.scene.records import Array, Joint, JointKind


def quaternion_matrix(q: Array) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz, normalised first."""
    q = np.asarray(q, dtype=np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_product(a: Array, b: Array) -> Array:
    """Hamilton product (..., 4) of quaternions wxyz."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def rotation_between(start: Array, end: Array) -> Array:
    """Rotation vector (..., 3), |r| <= pi, in the body frame that turns quaternion ``start`` (..., 4) into ``end``."""
    inverse = start * np.array([1.0, -1.0, -1.0, -1.0]) / np.sum(start * start, axis=-1, keepdims=True)
    step = quaternion_product(inverse, end)
    step = np.where(step[..., :1] < 0, -step, step)
    sine = np.linalg.norm(step[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, step[..., :1])
    small = sine < 1e-10
    return step[..., 1:] * np.where(small, 2.0, angle / np.where(small, 1.0, sine))


def rotate_by(start: Array, vector: Array) -> Array:
    """Quaternion (..., 4), unit: ``start`` followed by the body-frame rotation vector (..., 3)."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    scale = 0.5 * np.sinc(angle / (2 * np.pi))
    step = np.concatenate([np.cos(angle / 2), scale * vector], axis=-1)
    end = quaternion_product(start, step)
    return end / np.linalg.norm(end, axis=-1, keepdims=True)


def difference(joints: Sequence[Joint], nv: int, q_from: Array, q_to: Array) -> Array:
    """Tangent vectors (..., nv) that lead from ``q_from`` to ``q_to`` (both (..., nq))."""
    q_from, q_to = np.broadcast_arrays(np.asarray(q_from, dtype=np.float64), np.asarray(q_to, dtype=np.float64))
    out = np.empty((*q_from.shape[:-1], nv))
    for joint in joints:
        i, k = joint.qadr, joint.vadr
        if joint.kind == JointKind.BALL:
            out[..., k : k + 3] = rotation_between(q_from[..., i : i + 4], q_to[..., i : i + 4])
        else:
            out[..., k] = q_to[..., i] - q_from[..., i]
    return out


def integrate(joints: Sequence[Joint], q: Array, dv: Array) -> Array:
    """Configurations (..., nq): ``q`` moved by tangent vectors ``dv`` (..., nv); quaternions come out unit."""
    q, dv = np.asarray(q, dtype=np.float64), np.asarray(dv, dtype=np.float64)
    shape = np.broadcast_shapes(q.shape[:-1], dv.shape[:-1])
    out = np.broadcast_to(q, (*shape, q.shape[-1])).copy()
    single = [joint for joint in joints if joint.kind != JointKind.BALL]
    out[..., [joint.qadr for joint in single]] += dv[..., [joint.vadr for joint in single]]
    for joint in joints:
        i, k = joint.qadr, joint.vadr
        if joint.kind == JointKind.BALL:
            out[..., i : i + 4] = rotate_by(out[..., i : i + 4], np.broadcast_to(dv[..., k : k + 3], (*shape, 3)))
    return out
