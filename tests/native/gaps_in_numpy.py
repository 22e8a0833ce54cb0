"""Gaps of all candidates in numpy, written apart from the core, to check it by."""

from __future__ import annotations

import numpy as np

from cmbrl.scene.collision.contact_records import ContactKind
from cmbrl.scene.core.core_arrays import CoreArrays
from cmbrl.scene.kinematics import body_poses
from cmbrl.scene.records import Array

FLAT_TILT = 1e-3  # [rad] of a rim; the core's kFlat
BESIDE, AWAY = 1e-6, 1e3  # m: how far beside a side a corner still touches it; the gap of one that does not


def gaps(core: CoreArrays, q: Array) -> Array:
    """Gap [m] (..., ncontact) of every candidate at configurations q (..., nq), at the nominal parameters."""
    q = np.asarray(q, dtype=np.float64)
    pos, rot = body_poses(core, q)
    D = pos.shape[-1]
    layout, P = core.layout, core.P
    out = np.empty((*q.shape[:-1], core.ncontact))
    for i in range(core.ncontact):
        a, b = core.con_bodyA[i], core.con_bodyB[i]
        point = _place(pos, rot, a, core.con_posA[i])
        k = core.con_plane[i]
        if core.con_type[i] == ContactKind.HULLS:
            distance = np.full(q.shape[:-1], AWAY)  # looks at no gap that is open
        elif k >= 0:
            if core.con_type[i] == ContactKind.RIM_PLANE:
                point = point - _rim_arm(_direction(rot, a, core.con_axisA[i]), core.plane_normal[k])
            if core.con_type[i] == ContactKind.DISC_PLANE:
                axis, turn = _direction(rot, a, core.con_axisA[i]), core.con_along[i]
                arm = _rim_arm(axis, core.plane_normal[k])
                across = np.cross(axis / np.linalg.norm(axis, axis=-1, keepdims=True), arm)
                point = point - turn[0] * arm - turn[1] * across
                point = (
                    point
                    + np.where((turn[1] != 0) & (axis @ core.plane_normal[k] > 0), AWAY, 0)[..., None]
                    * (core.plane_normal[k])
                )
            distance = point @ core.plane_normal[k] - P[layout.plane(k)]
        else:
            relative = point - _place(pos, rot, b, core.con_posB[i])
            axis_b = _direction(rot, b, core.con_axisB[i])
            if core.con_type[i] == ContactKind.SEGMENT_SEGMENT:
                distance = _segments(relative, _direction(rot, a, core.con_axisA[i]), axis_b)
            elif np.any(core.con_halfB[i]):
                axes = core.con_rotB[i].reshape(D, D)
                frame = axes if b < 0 else rot[..., b, :, :] @ axes
                local = np.swapaxes(frame, -1, -2) @ relative[..., None]
                if core.con_type[i] == ContactKind.CORNER_BOX:
                    turn = np.swapaxes(frame, -1, -2) @ (np.eye(D) if a < 0 else rot[..., a, :, :])
                    offset = turn @ core.con_axisA[i][:, None]
                    distance = _corner(local, offset, turn @ core.con_rotA[i].reshape(D, D), core.con_halfB[i])
                else:
                    distance = _box(local, core.con_halfB[i])
            else:
                length = _dot(core.con_axisB[i], core.con_axisB[i])
                t = np.clip(_dot(axis_b, relative) / (length if length > 0 else 1.0), -1, 1)
                distance = np.linalg.norm(relative - t[..., None] * axis_b, axis=-1)
        out[..., i] = distance - P[layout.contact(i, "radius")]
    return out


def _corner(local: Array, offset: Array, axes: Array, half: Array) -> Array:
    """As `corner.hpp` of the core has it; columns (..., D, 1) and A's axes (..., D, D) in B's frame."""
    place, centre = local[..., 0], (local - offset)[..., 0]
    extent = np.sum(np.abs(axes * (np.swapaxes(axes, -1, -2) @ offset)[..., None, :, 0]), axis=-1)
    chosen = np.argmax(np.abs(centre) - half - extent, axis=-1)[..., None]
    side = np.where(np.take_along_axis(centre, chosen, -1) < 0, -1.0, 1.0)
    distance = side * np.take_along_axis(place, chosen, -1) - half[chosen]
    over = np.abs(place) - half
    np.put_along_axis(over, chosen, -1.0, -1)
    return np.where(np.any(over > BESIDE, axis=-1), distance[..., 0] + AWAY, distance[..., 0])


def _place(pos: Array, rot: Array, body: int, local: Array) -> Array:
    return local if body < 0 else pos[..., body, :] + rot[..., body, :, :] @ local


def _direction(rot: Array, body: int, local: Array) -> Array:
    return local if body < 0 else rot[..., body, :, :] @ local


def _dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1)


def _rim_arm(axis: Array, normal: Array) -> Array:
    """From the point of a rim that is nearest to a plane to its centre; ``axis`` is as long as the rim's radius.

    Of a rim that lies flat, within a tilt of FLAT_TILT, the point moves to the centre: see ``rim.hpp`` of the core.
    """
    square = _dot(axis, axis)
    down = normal - (axis @ normal / square)[..., None] * axis
    q = _dot(down, down)
    g = np.where(q >= FLAT_TILT**2, 1 / np.sqrt(np.maximum(q, FLAT_TILT**2)), (3 - q / FLAT_TILT**2) / (2 * FLAT_TILT))
    return (np.sqrt(square) * g)[..., None] * down


def _box(local: Array, half: Array) -> Array:
    """Signed distance of points (..., D, 1), in the frame of a box, to its surface; negative inside."""
    beyond = np.abs(local[..., 0]) - half
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return np.where(np.all(beyond < 0, axis=-1), beyond.max(axis=-1), outside)


def _segments(relative: Array, a: Array, b: Array) -> Array:
    """Distance of segments centre +- a and centre +- b; ``relative`` is a's centre minus b's.

    Closest points after Ericson, Real-Time Collision Detection (2005), 5.1.9, written for half vectors.
    """
    aa, bb, ab, ar, br = _dot(a, a), _dot(b, b), _dot(a, b), _dot(a, relative), _dot(b, relative)
    det = aa * bb - ab * ab
    safe = np.where(det > 1e-12 * aa * bb, det, 1.0)
    s = np.where(det > 1e-12 * aa * bb, np.clip((ab * br - bb * ar) / safe, -1, 1), 0.0)
    t = np.clip((ab * s + br) / np.where(bb > 0, bb, 1.0), -1, 1)
    s = np.clip((ab * t - ar) / np.where(aa > 0, aa, 1.0), -1, 1)
    return np.linalg.norm(relative + s[..., None] * a - t[..., None] * b, axis=-1)
