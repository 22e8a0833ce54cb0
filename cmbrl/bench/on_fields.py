"""How high a robot is over a height field: what has hills has no gap that a formula lowers a robot by."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cmbrl.scene import Scene
from cmbrl.scene.contact_records import ContactKind
from cmbrl.scene.records import Array

_ROUNDS = 25  # of halving some metres: to less than a micrometre
_OVER = 3.0  # m over the highest hill, where no robot touches


def on_fields(scene: Scene) -> np.ndarray:
    """(ncontact,) whether a candidate is of a shape and a height field."""
    core = scene.core
    hulls = core.con_type == ContactKind.HULLS
    return hulls & (core.hull_field[np.where(hulls, core.con_hullB, 0)] >= 0) if hulls.any() else hulls


def field_levels(scene: Scene) -> tuple[float, float]:
    """Heights [m] between which the surfaces of all fields of a scene are; they need not be level."""
    core, low, high = scene.core, np.inf, -np.inf
    for hull in np.flatnonzero(core.hull_field >= 0):
        points = core.hull_point[core.hull_ptr[hull] : core.hull_ptr[hull + 1]]
        low, high = min(low, float(points[:, 2].min())), max(high, float(points[:, 2].max()))
    return low, high


def lower(scene: Scene, q: Array, slide: int, gap: Array) -> None:
    """Moves coordinate ``slide`` of configurations q (B, nq), in place, to the least gap (B,) [m] to height fields.

    Those that never come so near, beside the field, stay as they are.
    """
    rows = on_fields(scene)
    now = q[:, slide].copy()

    def near(height: Array) -> np.ndarray:
        q[:, slide] = height
        return scene.gaps(q)[:, rows].min(axis=1) <= gap

    low, high = field_levels(scene)
    found, touched = halve(near, np.full(len(q), low), np.full(len(q), high + _OVER))
    q[:, slide] = np.where(touched, found, now)


def halve(near: Callable[[Array], np.ndarray], low: Array, high: Array) -> tuple[Array, np.ndarray]:
    """The heights (B,) between ``low`` and ``high`` below which all are ``near``; and (B,) whether they are at all."""
    touched = np.zeros(len(low), dtype=bool)
    for _ in range(_ROUNDS):
        middle = (low + high) / 2
        is_near = near(middle)
        touched |= is_near
        low, high = np.where(is_near, middle, low), np.where(is_near, high, middle)
    return high, touched
