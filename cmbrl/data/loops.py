"""Joints whose place follows from closed loops: the links of a parallel gripper, whose one encoder is at its motor.

A file closes a loop by connecting two bodies at a point (an equality ``connect``). Where that leaves some joints no
freedom beside those that were logged, a log need not tell them. They are found by Gauss-Newton on the gaps of the
loops, for all rows at once: from the file's own pose, in which loops are closed, the logged joints are moved to where
they were in small steps, so that a linkage stays in the branch in which it was assembled.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.records import WORLD, JointKind, TieKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_STEPS, _ITERATIONS, _LAST = 12, 2, 20  # from the file's pose, of each, and of the last one
_SMALL = 1e-5  # [rad, m] by which joints are moved for a slope
_RANK = 1e-6  # relative singular value below which a direction is free
_CLOSED = 1e-9  # [m]
_OPEN, _FEW = 2e-3, 0.01  # [m] and share of the rows: soft loops, and noise near the end of a range, leave less


def closing(scene: Scene, known: Collection[int]) -> list[int]:
    """Places in v of the hinges and slides that loops tell where those ``known``, by their places in v, are told."""
    unknown = [j.vadr for j in scene.joints if j.kind != JointKind.BALL and j.vadr not in known]
    if not unknown or not _connected(scene):
        return []
    slope = _slope(scene, _file_pose(scene)[None], unknown)[0]
    _, size, rows = np.linalg.svd(slope)
    told = np.zeros(len(unknown))
    told[: len(size)] = size
    free = rows[told <= _RANK * max(float(told.max()), _RANK)]
    return [place for place, held in zip(unknown, (np.abs(free) <= _RANK**0.5).all(axis=0), strict=True) if held]


def closed(scene: Scene, q: np.ndarray, places: list[int]) -> np.ndarray:
    """``q`` (T, nq) with the joints at ``places`` in v where they close the loops; raises UserError where none does."""
    address = {joint.vadr: joint.qadr for joint in scene.joints}
    moved, own = [address[place] for place in places], _file_pose(scene)
    others = np.setdiff1d(np.arange(scene.nq), moved)
    at = np.tile(own, (len(q), 1))
    straight = [j.qadr for j in scene.joints if j.kind != JointKind.BALL]
    for step in range(1, _STEPS + 1):
        at[:, others] = q[:, others]
        along = np.intersect1d(others, straight)
        at[:, along] = own[along] + step / _STEPS * (q[:, along] - own[along])
        for _ in range(_ITERATIONS if step < _STEPS else _LAST):
            gap = _gaps(scene, at)
            if np.abs(gap).max(initial=0.0) < _CLOSED:
                break
            at[:, moved] -= (np.linalg.pinv(_slope(scene, at, places), rcond=_RANK) @ gap[:, :, None])[:, :, 0]
    apart = np.abs(_gaps(scene, at)).max(axis=1)
    if (apart > _OPEN).mean() > _FEW:
        names = ", ".join(repr(joint.name) for joint in scene.joints if joint.vadr in places)
        raise UserError(
            f"the logged joints leave loops of scene {scene.name!r} open by up to {1e3 * apart.max():.2g} mm: check "
            f"their signs, units and zeros, or log {names} too"
        )
    return at


def _file_pose(scene: Scene) -> np.ndarray:
    """Configuration (nq,) in which the file has been assembled."""
    q = np.zeros(scene.nq)
    for joint in scene.joints:
        q[joint.qadr] = 1.0 if joint.kind == JointKind.BALL else joint.q0
    return q


def _connected(scene: Scene) -> list[int]:
    """Numbers of the ties that close loops."""
    return np.flatnonzero(scene.core.tie_type == TieKind.CONNECT).tolist()


def _gaps(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Gaps (T, g) [m] of the loops at configurations ``q`` (T, nq)."""
    core = scene.core
    places, turns = scene.body_poses(q)

    def point(body: int, own: np.ndarray) -> np.ndarray:
        return own if body == WORLD else places[:, body] + turns[:, body] @ own

    pairs = [
        (point(int(core.tie_A[k]), core.tie_posA[k]), point(int(core.tie_B[k]), core.tie_posB[k]))
        for k in _connected(scene)
    ]
    return np.concatenate([np.broadcast_to(a - b, (len(q), len(core.tie_posA[0]))) for a, b in pairs], axis=1)


def _slope(scene: Scene, q: np.ndarray, places: list[int]) -> np.ndarray:
    """Derivatives (T, g, k) of the gaps in the joints at ``places`` in v."""
    address = {joint.vadr: joint.qadr for joint in scene.joints}
    columns = []
    for place in places:
        e = _SMALL * (np.arange(scene.nq) == address[place])
        columns.append((_gaps(scene, q + e) - _gaps(scene, q - e)) / (2.0 * _SMALL))
    return np.stack(columns, axis=2)
