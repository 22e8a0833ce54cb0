"""A sphere, capsule or box in place of a convex shape that has no contact of its own with another body.

The best of each kind is the one whose surface is nearest: the largest difference of both support functions over all
directions, which is the Hausdorff distance of the two shapes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from cmbrl.scene.collision.shapes import Shape
from cmbrl.scene.records import Array

CONVEX = ("sphere", "capsule", "box", "cylinder", "ellipsoid", "mesh")
OWN = ("sphere", "capsule", "box")  # have contact with each other
_DIRECTIONS = 600
_BOXY = 0.7  # a box, which takes many rows, has to be this much better than a capsule
_RADII = np.linspace(0.6, 1.15, 23)  # tried, times half the shape's width


@dataclass(frozen=True)
class StandIn:
    """``shape`` errs by at most ``error`` [m] from what it stands for."""

    shape: Shape
    error: float


def stand_in(shape: Shape) -> StandIn:
    """Of any convex shape; of a sphere, capsule or box itself."""
    if shape.kind in OWN:
        return StandIn(shape, 0.0)
    found = [_box(shape), *(_capsule(shape, axis) for axis in range(3))]
    box, best = found[0], min(found[1:], key=lambda x: x.error)
    return box if box.error < _BOXY * best.error else best


def support(shape: Shape, u: Array) -> Array:
    """Extent [m] (n,) of a shape from its centre along unit directions u (n, 3) of its own frame."""
    size = shape.size
    if shape.kind == "sphere":
        return np.full(len(u), size[0])
    if shape.kind == "capsule":
        return size[0] + size[1] * np.abs(u[:, 2])
    if shape.kind == "box":
        return np.abs(u) @ size
    if shape.kind == "cylinder":
        return size[0] * np.hypot(u[:, 0], u[:, 1]) + size[1] * np.abs(u[:, 2])
    if shape.kind == "ellipsoid":
        return np.asarray(np.linalg.norm(u * size, axis=1))
    return np.asarray((u @ shape.hull.T).max(axis=1))


@lru_cache(maxsize=1)
def _directions() -> Array:
    """Unit vectors (n, 3), spread evenly (a Fibonacci lattice), and the axes."""
    k = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    return np.vstack([np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z]), np.eye(3), -np.eye(3)])


def _extent(shape: Shape) -> tuple[Array, Array]:
    """Centre and half sizes (3,) of the box around a shape, along its own axes."""
    high, low = support(shape, np.eye(3)), -support(shape, -np.eye(3))
    return (high + low) / 2, (high - low) / 2


def _box(shape: Shape) -> StandIn:
    """The box around a shape, shrunk until it errs as much outside as inside."""
    u = _directions()
    centre, half = _extent(shape)
    wanted = support(shape, u) - u @ centre
    scales = np.linspace(0.75, 1.0, 26)
    errors = [float(np.abs(scale * (np.abs(u) @ half) - wanted).max()) for scale in scales]
    best = int(np.argmin(errors))
    size = scales[best] * half
    return StandIn(_placed(shape, "box", centre, np.eye(3), size), errors[best])


def _capsule(shape: Shape, axis: int) -> StandIn:
    """Along one of the shape's axes; a sphere where the shape is no longer than it is wide."""
    u = _directions()
    centre, half = _extent(shape)
    wanted = support(shape, u) - u @ centre
    width = float(np.delete(half, axis).mean())
    best: tuple[float, float, float] | None = None
    for radius in width * _RADII:
        for end in (
            half[axis] - radius,
            half[axis] - 0.7 * radius,
        ):  # its ends touch the shape's, or stick out a little
            length = max(0.0, float(end))
            error = float(np.abs(radius + length * np.abs(u[:, axis]) - wanted).max())
            if best is None or error < best[0]:
                best = error, float(radius), length
    assert best is not None
    error, radius, length = best
    turn = np.eye(3)[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]
    kind = "capsule" if length > 0 else "sphere"
    return StandIn(_placed(shape, kind, centre, turn, np.array([radius, length, 0.0])), error)


def _placed(shape: Shape, kind: str, centre: Array, turn: Array, size: Array) -> Shape:
    return replace(
        shape,
        kind=kind,
        pos=shape.pos + shape.rot @ centre,
        rot=shape.rot @ turn,
        size=size,
        bound=float(size[0] + size[1]) if kind != "box" else float(np.linalg.norm(size)),
        hull=np.zeros((0, 3)),
        rounding=0.0,
    )
