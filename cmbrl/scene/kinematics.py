"""Body positions in numpy, for any batch shape. For reports; the core computes them faster.

Conventions are MuJoCo's: a hinge or ball turns the body about its anchor, a slide moves it along its axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.core.core_arrays import CoreArrays
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import WORLD, Array, JointKind


def addresses(core: CoreArrays) -> NDArray[np.int64]:
    """Places (nv,) in q of the coordinates of hinges and slides; -1 for those of balls."""
    places = np.full(core.nv, -1)
    for kind, qadr, vadr in zip(core.jnt_type, core.jnt_qadr, core.jnt_vadr, strict=True):
        if kind != JointKind.BALL:
            places[vadr] = qadr
    return places


def lines_by_dof(core: CoreArrays) -> NDArray[np.bool_]:
    """Which lines (nv + ntendon, nv) each degree of freedom changes."""
    moves = np.zeros((core.ntendon, core.nv), dtype=bool)
    moves[np.repeat(np.arange(core.ntendon), np.diff(core.tendon_ptr)), core.tendon_dof] = True
    return np.concatenate([np.eye(core.nv, dtype=bool), moves])


def body_poses(core: CoreArrays, q: Array) -> tuple[Array, Array]:
    """Positions (..., nb, D) [m] and rotations (..., nb, D, D) at configurations q (..., nq)."""
    return poses(core, q)[:2]


def poses(core: CoreArrays, q: Array) -> tuple[Array, Array, Array, Array]:
    """Those of bodies, then anchors (..., nj, D) of joints and the axes (..., nj, D, D) of what each has moved."""
    q = np.asarray(q, dtype=np.float64)
    planar, batch = core.planar, q.shape[:-1]
    D, nb = core.layout.dimension, core.nbody
    pos, rot = np.zeros((*batch, nb, D)), np.zeros((*batch, nb, D, D))
    anchors, axes = np.zeros((*batch, len(core.jnt_type), D)), np.zeros((*batch, len(core.jnt_type), D, D))
    for b in range(nb):
        parent = core.body_parent[b]
        x, R = core.body_pos[b], _fixed_rotation(core.body_rot[b])
        if parent >= 0:
            x, R = pos[..., parent, :] + rot[..., parent, :, :] @ x, rot[..., parent, :, :] @ R
        for j in range(core.body_jadr[b], core.body_jadr[b] + core.body_jnum[b]):
            kind, i, axis, local = core.jnt_type[j], core.jnt_qadr[j], core.jnt_axis[j], core.jnt_pos[j]
            if kind == JointKind.SLIDE:
                x = x + (R @ axis) * (q[..., i] - core.jnt_q0[j])[..., None]
                anchors[..., j, :], axes[..., j, :, :] = x, R
                continue
            anchor = x + R @ local
            if kind == JointKind.BALL:
                R = R @ quaternion_matrix(q[..., i : i + 4])
            else:
                R = R @ _turn(axis, q[..., i] - core.jnt_q0[j], planar)
            x = anchor - R @ local
            anchors[..., j, :], axes[..., j, :, :] = anchor, R
        pos[..., b, :], rot[..., b, :, :] = x, R
    return pos, rot, anchors, axes


def motion(core: CoreArrays, j: int, frames: Array, arm: Array) -> Array:
    """How points at ``arm`` (..., D) from the anchor of joint ``j`` move with it: (..., D, dofs), at its ``frames``."""
    kind, axis = core.jnt_type[j], core.jnt_axis[j]
    if kind == JointKind.SLIDE:
        return np.asarray(frames @ axis)[..., None]
    if core.planar:
        return np.stack([-arm[..., 1], arm[..., 0]], axis=-1)[..., None] * axis[0]
    turns = frames if kind == JointKind.BALL else (frames @ axis)[..., None]
    return np.stack([np.cross(turns[..., k], arm) for k in range(turns.shape[-1])], axis=-1)


def centre_of_mass(core: CoreArrays, q: Array) -> Array:
    """The centre of mass (..., D) [m] of all bodies, by the masses of the file, at configurations q (..., nq)."""
    mass = np.array([core.P[core.layout.mass(b)] for b in range(core.nbody)])
    return np.einsum("...bi,b->...i", centres(core, q), mass) / mass.sum()


def centres(core: CoreArrays, q: Array) -> Array:
    """Centres of mass (..., nb, D) [m] of the bodies in the world at configurations q (..., nq)."""
    layout, D = core.layout, core.layout.dimension
    pos, rot = body_poses(core, q)
    com = np.array([core.P[layout.com(b) : layout.com(b) + D] for b in range(core.nbody)])
    return np.asarray(pos + np.einsum("...bij,bj->...bi", rot, com))


def holding_forces(core: CoreArrays, q: Array, acceleration: Array | None = None) -> Array:
    """What motors must give (..., nv) [N m, N] to hold the weight of all bodies at configurations q (..., nq), at rest.

    By the masses of the file; without springs, contacts and gravity compensation. ``acceleration`` (..., nb, D): that
    of the centres, in place of gravity's, upwards.
    """
    layout, D = core.layout, core.layout.dimension
    pos, rot, anchors, axes = poses(core, q)
    found = np.zeros((*pos.shape[:-2], core.nv))
    upwards = np.broadcast_to(-core.P[layout.gravity : layout.gravity + D], pos.shape)
    push = upwards if acceleration is None else acceleration
    for b in range(core.nbody):
        at = pos[..., b, :] + rot[..., b, :, :] @ core.P[layout.com(b) : layout.com(b) + D]
        for j in joints_above(core, b):
            moved = motion(core, j, axes[..., j, :, :], at - anchors[..., j, :])
            first, force = int(core.jnt_vadr[j]), core.P[layout.mass(b)] * push[..., b, :]
            found[..., first : first + moved.shape[-1]] += (force[..., None, :] @ moved)[..., 0, :]
    return found


def joints_above(core: CoreArrays, body: int) -> list[int]:
    """Numbers of the joints that move ``body``; none of the WORLD."""
    found = list[int]()
    while body != WORLD:
        first = int(core.body_jadr[body])
        found += range(first, first + int(core.body_jnum[body]))
        body = int(core.body_parent[body])
    return found


def _fixed_rotation(row: Array) -> Array:
    return np.array([[row[0], -row[1]], [row[1], row[0]]]) if len(row) == 2 else row.reshape(3, 3)


def _turn(axis: Array, angle: Array, planar: bool) -> Array:
    """Rotation matrices (..., D, D) about a joint axis by angles (...)."""
    if planar:
        c, s = np.cos(angle), axis[0] * np.sin(angle)
        return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
    half = 0.5 * np.asarray(angle)[..., None]
    return quaternion_matrix(np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1))
