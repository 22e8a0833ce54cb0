"""The contact candidates of two shapes: which features of one may touch which of the other."""

from __future__ import annotations

import numpy as np

from cmbrl.scene.collision.contact_records import UPRIGHT, ZERO, Candidate, ContactKind, ContactLaw, When
from cmbrl.scene.collision.shapes import Shape, Touch
from cmbrl.scene.collision.stand_ins import CONVEX
from cmbrl.scene.records import WORLD, Array

ROUND = ("sphere", "capsule")


def on_plane(shape: Shape, plane: Shape, touch: Touch, law: ContactLaw) -> Candidate:
    """What ``touch`` of a shape does over a plane of the world."""
    kind = ContactKind.RIM_PLANE if np.any(touch.rim) else ContactKind.POINT_PLANE
    axis = touch.rim if kind == ContactKind.RIM_PLANE else touch.arm
    frame, along = UPRIGHT, shape.rot[:, 2] if shape.kind == "capsule" else ZERO
    if touch.oval is not None:
        kind, frame = ContactKind.OVAL_PLANE, touch.oval
    if touch.turn is not None:
        kind, frame, along = ContactKind.DISC_PLANE, shape.rot, touch.turn
    return Candidate(
        kind, (shape.geom, plane.geom), shape.body, WORLD,
        touch.pos, axis, ZERO, ZERO, UPRIGHT, ZERO, touch.radius, 0.0, law, touch.weight,
        along=along, rot_a=frame, when=touch.when,
    )  # fmt: skip


def between(a: Shape, b: Shape, law: ContactLaw, across: Array | None, when: When = When.ALWAYS) -> list[Candidate]:
    """Of two spheres, capsules or boxes.

    ``across`` (3,): in a plane of motion, its normal in the box's body frame: only edges along it are seen there.
    """
    if a.kind in ROUND and b.kind in ROUND:
        return [_round_pair(a, b, law, when)]
    if a.kind == b.kind:
        return [*_corners(a, b, law, when), *_corners(b, a, law, when)]
    ball, box = (a, b) if a.kind in ROUND else (b, a)
    return _round_box(ball, box, law, across, when)


def of_hulls(a: Shape, b: Shape, law: ContactLaw) -> list[Candidate]:
    """What touches as in MuJoCo where rows do not look ahead: all but spheres and capsules among themselves, and
    spheres with boxes.

    Only gaps that are closed, or within margin and gap, are seen. Of two boxes, edges that cross wherever they are:
    corners alone would let them through each other.
    """
    kinds, boxes = {a.kind, b.kind}, a.kind == b.kind == "box"
    if not kinds <= {*CONVEX} or kinds <= {*ROUND} or kinds == {"sphere", "box"}:
        return []
    if not (a.sides and b.sides) or a.rounding or b.rounding:
        return []
    a, b = (b, a) if a.body == WORLD else (a, b)
    kind, geoms, when = ContactKind.HULLS, (a.geom, b.geom), When.ALWAYS if boxes else When.CLOSED
    one = Candidate(
        kind, geoms, a.body, b.body, a.pos, ZERO, b.pos, ZERO, UPRIGHT, ZERO, 0.0, 0.0, law, when=when,
    )  # fmt: skip
    return [one] * _most_points(kinds)


def of_field(shape: Shape, field: Shape, law: ContactLaw, most: int) -> list[Candidate]:
    """A convex shape on a height field of the world: as many candidates as it can touch triangles of it with points."""
    one = Candidate(
        ContactKind.HULLS, (shape.geom, field.geom), shape.body, WORLD,
        shape.pos, ZERO, field.pos, ZERO, UPRIGHT, ZERO, 0.0, 0.0, law,
    )  # fmt: skip
    return [one] * most


def _most_points(kinds: set[str]) -> int:
    """Of MuJoCo's contact of two convex shapes."""
    if kinds == {"box"}:
        return 8
    if kinds == {"capsule", "box"}:
        return 2
    return 1 if kinds & {"sphere", "ellipsoid"} else 4


def _round_pair(a: Shape, b: Shape, law: ContactLaw, when: When) -> Candidate:
    """Spheres and capsules: a point of A against a segment of B, or two segments; B may be the world."""
    if WORLD in (a.body, b.body):
        a, b = (b, a) if a.body == WORLD else (a, b)
    elif a.kind == "capsule" and b.kind == "sphere":
        a, b = b, a
    kind = ContactKind.SEGMENT_SEGMENT if a.kind == "capsule" else ContactKind.POINT_SHAPE
    return Candidate(
        kind, (a.geom, b.geom), a.body, b.body,
        a.pos, a.axis, b.pos, b.axis, UPRIGHT, ZERO, a.radius, b.radius, law,
        when=when,
    )  # fmt: skip


def _point_box(shape: Shape, point: Array, radius: float, box: Shape, law: ContactLaw, when: When) -> Candidate:
    return Candidate(
        ContactKind.POINT_SHAPE, (shape.geom, box.geom), shape.body, box.body,
        point, ZERO, box.pos, ZERO, box.rot, box.core, radius, box.radius, law,
        when=when,
    )  # fmt: skip


def _corners(a: Shape, b: Shape, law: ContactLaw, when: When) -> list[Candidate]:
    """The corners of box A against box B."""
    kind, geoms, of_a, of_b = ContactKind.CORNER_BOX, (a.geom, b.geom), a.rot, b.rot
    centre, core, rounding_a, rounding_b = b.pos, b.core, a.radius, b.radius
    return [
        Candidate(
            kind, geoms, a.body, b.body, corner, arm, centre, ZERO, of_b, core, rounding_a, rounding_b, law, 1.0, of_a,
            ZERO, when,
        )
        for corner, arm in a.corners
    ]  # fmt: skip


def _round_box(ball: Shape, box: Shape, law: ContactLaw, across: Array | None, when: When) -> list[Candidate]:
    """A sphere, or both ends of a capsule, against a box; a capsule's side against its edges, or those ``across``."""
    if ball.kind == "sphere":
        return [_point_box(ball, ball.pos, ball.radius, box, law, when)]
    ends = [_point_box(ball, end, ball.radius, box, law, when) for end in ball.ends]
    edges = list(box.edges)
    if across is not None:
        edges = [edge for edge in edges if abs(edge.rot[:, 2] @ across) > 1 - 1e-6] or edges
    return ends + [_round_pair(ball, edge, law, when) for edge in edges]
