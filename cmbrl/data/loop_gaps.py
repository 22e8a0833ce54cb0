"""Gaps of closed loops, how they change with joints, and the Gauss-Newton steps that close them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cmbrl.scene import kinematics
from cmbrl.scene.records import WORLD, TieKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

RANK = 1e-6  #: relative singular value below which a direction is free
OPEN = 2e-3  #: [m]: soft loops leave less
CLOSED = 1e-9  #: [m]


def nearer(scene: Scene, q: np.ndarray, places: list[int], iterations: int, enough: float = CLOSED) -> np.ndarray:
    """``q`` (T, nq) after so many Gauss-Newton steps of the joints at ``places`` in v towards closed loops.

    Fewer where no gap is left wider than ``enough`` [m].
    """
    for _ in range(iterations):
        gap = gaps(scene, q)
        if np.abs(gap).max(initial=0.0) < enough:
            break
        step = np.zeros((len(q), scene.nv))
        step[:, places] = -(np.linalg.pinv(slope(scene, q, places), rcond=RANK) @ gap[:, :, None])[:, :, 0]
        q = scene.integrate(q, step)
    return q


def connected(scene: Scene) -> list[int]:
    """Numbers of the ties that close loops."""
    return np.flatnonzero(scene.core.tie_type == TieKind.CONNECT).tolist()


def _points(scene: Scene, k: int, places: np.ndarray, turns: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """The two bodies of tie ``k``, and where (T, D) each has its point, by the poses of all bodies."""
    core, found = scene.core, []
    for body, own in ((int(core.tie_A[k]), core.tie_posA[k]), (int(core.tie_B[k]), core.tie_posB[k])):
        at = np.broadcast_to(own, places[:, 0].shape) if body == WORLD else places[:, body] + turns[:, body] @ own
        found.append((body, at))
    return found


def gaps(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Gaps (T, g) [m] of the loops at configurations ``q`` (T, nq)."""
    poses = scene.body_poses(q)
    pairs = (_points(scene, k, *poses) for k in connected(scene))
    return np.concatenate([a - b for (_, a), (_, b) in pairs], axis=1)


def slope(scene: Scene, q: np.ndarray, places: list[int]) -> np.ndarray:
    """Derivatives (T, g, k) of the gaps in the joints at ``places`` in v."""
    core, (pos, rot, anchors, axes) = scene.core, kinematics.poses(scene.core, q)
    loops = []
    for k in connected(scene):
        moves = np.zeros((len(q), pos.shape[2], scene.nv))
        for (body, point), side in zip(_points(scene, k, pos, rot), (1.0, -1.0), strict=True):
            for j in kinematics.joints_above(core, body):
                moved = kinematics.motion(core, j, axes[:, j], point - anchors[:, j])
                first = int(core.jnt_vadr[j])
                moves[:, :, first : first + moved.shape[2]] += side * moved
        loops.append(moves[:, :, places])
    return np.concatenate(loops, axis=1)
