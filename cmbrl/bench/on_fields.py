"""How high a robot is over a height field: what has hills has no gap that a formula lowers a robot by."""

from __future__ import annotations

import numpy as np

from cmbrl.scene import Scene
from cmbrl.scene.collision.contact_records import ContactKind
from cmbrl.scene.records import Array

_ROUNDS = 12
_SIGHT = 0.04  # m: nearer, the core tells the gap to a field
_ROUND = 2  # kinds of hulls from here on fill the box whose corners they have


def on_fields(scene: Scene) -> np.ndarray:
    """(ncontact,) whether a candidate is of a shape and a height field."""
    core = scene.core
    hulls = core.con_type == ContactKind.HULLS
    return hulls & (core.hull_field[np.where(hulls, core.con_hullB, 0)] >= 0) if hulls.any() else hulls


def lower(scene: Scene, q: Array, slide: int, gap: Array) -> None:
    """Moves coordinate ``slide``, a vertical one, of q (B, nq), in place, to gaps (B,) [m] to fields under corners.

    A corner is that of a hull, or the end of an axis of a round shape; hills between corners may reach farther up.
    Configurations without a corner over a field stay as they are.
    """
    heights = clearance(scene, q)
    q[:, slide] -= np.where(np.isfinite(heights), heights - gap, 0.0)


def settle(scene: Scene, q: Array, slide: int, gap: float) -> None:
    """The same of one configuration (nq,), until the gap of all that may touch a field is ``gap`` [m]."""
    lower(scene, q[None], slide, np.full(1, gap))
    for _ in range(_ROUNDS):
        now = float(scene.gaps(q)[on_fields(scene)].min())
        q[slide] -= now - gap if now < 2 * _SIGHT else _SIGHT


def clearance(scene: Scene, q: Array) -> Array:
    """How far (B,) [m] the lowest corner is above the field under it, at configurations q (B, nq); inf beside all."""
    core, lowest = scene.core, np.full(len(q), np.inf)
    position, rotation = scene.body_poses(q)
    rows = on_fields(scene)
    pairs = np.column_stack([core.con_bodyA, core.con_hull, core.con_hullB])[rows]
    for body, hull, field in np.unique(pairs, axis=0).tolist():
        points = position[:, body, None] + _corners(scene, hull) @ rotation[:, body].swapaxes(-1, -2)
        lowest = np.minimum(lowest, _above(scene, field, points).min(axis=1))
    return lowest


def _corners(scene: Scene, hull: int) -> Array:
    points = scene.core.hull_point[slice(*scene.core.hull_ptr[hull : hull + 2])]
    if scene.core.hull_kind[hull] < _ROUND:
        return points
    centre, half = points.mean(axis=0), (points[[4, 2, 1]] - points[0]) / 2
    return np.concatenate([centre + half, centre - half])


def _above(scene: Scene, hull: int, points: Array) -> Array:
    """Heights (...) [m] of points (..., 3) over the field of a hull; inf beside it. Cells are taken for bilinear."""
    core, field = scene.core, int(scene.core.hull_field[hull])
    box = core.hull_point[core.hull_ptr[hull] : core.hull_ptr[hull + 1]]
    sides = box[[4, 2, 1]] - box[0]
    size = np.linalg.norm(sides, axis=1)
    local = (points - box[0]) @ (sides / size[:, None]).T
    rows, columns = core.field_size[2 * field : 2 * field + 2]
    heights = core.field_height[core.field_ptr[field] : core.field_ptr[field + 1]].reshape(rows, columns)
    at = local[..., :2] / size[:2] * [columns - 1, rows - 1]
    inside = np.all((at >= 0) & (at <= [columns - 1, rows - 1]), axis=-1)
    cell = np.clip(at.astype(int), 0, [columns - 2, rows - 2])
    x, y = np.moveaxis(at - cell, -1, 0)
    c, r = np.moveaxis(cell, -1, 0)
    under = (1 - y) * ((1 - x) * heights[r, c] + x * heights[r, c + 1])
    under += y * ((1 - x) * heights[r + 1, c] + x * heights[r + 1, c + 1])
    return np.where(inside, local[..., 2] - under, np.inf)
