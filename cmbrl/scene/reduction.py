"""Detects that everything moves in one plane, and rewrites the scene in that plane.

A tree is planar if every joint is a slide in the plane or a hinge about its normal; offsets along the normal then
change nothing. The basis (e1, e2) of the plane and the axis a = e1 x e2 of positive planar angles are world vectors.
For robots that move in x-z they are x, z and -y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.scene.collision.contact_records import ROUND_ENDS, Candidate, ContactKind
from cmbrl.scene.records import WORLD, Array, Joint, JointKind, Tree

_ALIGNED = 1e-9


@dataclass(frozen=True)
class PlaneOfMotion:
    """Basis of the plane in world coordinates, and the planar angle of every moving body's frame at qpos0."""

    basis: Array  # (2, 3) rows e1, e2
    axis: Array  # (3,) e1 x e2
    rot: Array  # (nb, 2, 2) planar rotation of the bodies' frames at qpos0

    def local(self, tree: Tree, body: int, vector: Array) -> Array:
        """Maps a vector or point (3,) of a body's (or the world's) frame to its planar frame (2,)."""
        flat = self.basis @ tree.turn(body, vector)
        return flat if body == WORLD else self.rot[body].T @ flat

    @property
    def letters(self) -> tuple[str, str]:
        """Names of the two directions: x, y, z if they are world axes, otherwise 1 and 2."""
        named = ["xyz"[int(np.argmax(np.abs(e)))] if np.max(np.abs(e)) > 1 - _ALIGNED else "" for e in self.basis]
        return (named[0], named[1]) if all(named) else ("1", "2")


def find_plane(tree: Tree, gravity: Array) -> tuple[PlaneOfMotion | None, str]:
    """The plane in which all joints move, or None; and the reason. ``gravity`` (3,) decides where joints do not."""
    turns: list[tuple[Joint, Array]] = []
    slides: list[tuple[Joint, Array]] = []
    for joint in tree.joints:
        if joint.kind == JointKind.BALL:
            return None, f"joint {joint.name} rotates about every axis"
        (turns if joint.kind == JointKind.HINGE else slides).append((joint, tree.turn(joint.body, joint.axis)))
    normal = turns[0][1] if turns else _slide_normal([axis for _, axis in slides], gravity)
    for joint, axis in turns:
        if np.linalg.norm(np.cross(axis, normal)) > _ALIGNED:
            return None, f"hinges {turns[0][0].name} and {joint.name} are not parallel"
    for joint, axis in slides:
        if abs(axis @ normal) > _ALIGNED:
            return None, f"slide {joint.name} leaves the plane of the others"
    basis = _basis(normal)
    axis = np.cross(*basis)
    rot = np.tile(np.eye(2), (len(tree.bodies), 1, 1))
    for k, world in enumerate(tree.world_rot):
        if np.linalg.norm(world @ axis - axis) < _ALIGNED:  # otherwise keep the world's axes
            rot[k] = basis @ world @ basis.T
    return PlaneOfMotion(basis, axis, rot), "every joint slides in one plane or rotates about its normal"


def _slide_normal(axes: list[Array], gravity: Array) -> Array:
    for second in [*axes[1:], gravity, *np.eye(3)]:
        normal = np.cross(axes[0], second)
        if np.linalg.norm(normal) > 1e-6 * max(1e-12, float(np.linalg.norm(second))):
            return normal / np.linalg.norm(normal)
    raise AssertionError("three world axes cannot all be parallel to one slide")


def _basis(normal: Array) -> Array:
    """Rows e1, e2 of the plane: e2 as close to world z as possible (y if the normal is z), e1 along +x or +y."""
    near = np.round(normal)
    if np.linalg.norm(normal - near) < _ALIGNED:
        normal = near
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 1 - 1e-6 else np.array([0.0, 1.0, 0.0])
    e2 = up - (up @ normal) * normal
    e2 /= np.linalg.norm(e2)
    e1 = np.cross(e2, normal)
    e1 *= np.sign(e1[np.argmax(np.abs(e1))])
    return np.array([e1, e2]) + 0.0  # no negative zeros


def obstacle_to_plane(tree: Tree, plane: PlaneOfMotion, candidate: Candidate, up: Array | None) -> str | None:
    """Why a candidate has no planar image, or None. ``up`` (3,): world normal of the plane it may touch, if any."""
    axis = plane.axis
    if candidate.kind.on_plane:
        if up is None or abs(up @ axis) > _ALIGNED:
            return "the normal of a plane leaves the plane of motion"
        return "a cylinder is oblique to the plane of motion" if candidate.kind in ROUND_ENDS else None
    if candidate.kind == ContactKind.HULLS:
        return "hulls touch in space"
    depth = 0.0  # extent of both shapes along the normal, over which their section is constant
    corner = candidate.kind == ContactKind.CORNER_BOX
    segments = () if corner else ((candidate.body_a, candidate.axis_a), (candidate.body_b, candidate.axis_b))
    for body, half in segments:
        world = tree.turn(body, half)
        along = float(abs(world @ axis))
        if along > _ALIGNED and np.linalg.norm(world - (world @ axis) * axis) > _ALIGNED:
            return "a capsule is oblique to the plane of motion"
        depth += along
    boxes = [(candidate.body_b, candidate.rot_b, candidate.half_b)] if np.any(candidate.half_b) else []
    if corner:
        half_a = np.abs(candidate.rot_a.T @ candidate.axis_a)
        boxes.append((candidate.body_a, candidate.rot_a, np.zeros(3)))
        depth += 2 * half_a[int(np.argmax(np.abs(tree.turn(candidate.body_a, candidate.rot_a).T @ axis)))]
    for body, rot, half in boxes:
        sides = np.abs(tree.turn(body, rot).T @ axis)
        if np.max(sides) < 1 - _ALIGNED:
            return "a box is oblique to the plane of motion"
        depth += half[int(np.argmax(sides))]
    offset = tree.place(candidate.body_a, candidate.pos_a) - tree.place(candidate.body_b, candidate.pos_b)
    if abs(offset @ axis) > depth + _ALIGNED:
        return "two round shapes touch outside the plane of their centres"
    if corner and _side_by_side(tree, axis, candidate):
        return "boxes overlap in part along the normal of the plane of motion"
    return None


def oblique_pyramid(tree: Tree, plane: PlaneOfMotion, candidate: Candidate, up: Array | None) -> bool:
    """Whether MuJoCo's tangents at a candidate, along which its pyramid lies, are neither in the plane nor across it.

    The first is made of a capsule's axis, or of the world's y, or of its z where the normal is near y.
    """
    if np.any(candidate.along):
        return _is_oblique(tree.turn(candidate.body_a, candidate.along), plane.axis)
    _, y, z = np.eye(3)
    if up is None:  # the normal turns
        return _is_oblique(y, plane.axis) or _is_oblique(z, plane.axis)
    first = y if abs(up[1]) < 0.5 else z
    first = first - (first @ up) * up
    return _is_oblique(first / np.linalg.norm(first), plane.axis)


def _is_oblique(direction: Array, axis: Array) -> bool:
    return _ALIGNED < abs(float(direction @ axis)) < 1 - _ALIGNED


def _side_by_side(tree: Tree, axis: Array, corner: Candidate) -> bool:
    """Whether two boxes overlap along ``axis`` by less than half of the thinner: MuJoCo then parts them along it."""
    half_a = np.abs(corner.rot_a.T @ corner.axis_a)
    sides = ((corner.body_a, corner.rot_a, half_a), (corner.body_b, corner.rot_b, corner.half_b))
    a, b = (float(half[int(np.argmax(np.abs(tree.turn(body, rot).T @ axis)))]) for body, rot, half in sides)
    centre = tree.place(corner.body_a, corner.pos_a - corner.axis_a)
    apart = abs(float((centre - tree.place(corner.body_b, corner.pos_b)) @ axis))
    return a + b - apart < min(a, b)


def project(tree: Tree, plane: PlaneOfMotion, candidate: Candidate) -> Candidate:
    """The planar image of a candidate: vectors (2,), sections of its shapes; a capsule along the normal is a point."""
    a, b = candidate.body_a, candidate.body_b
    rot_a, rot_b, half_b = np.eye(2), np.eye(2), np.zeros(2)
    if np.any(candidate.half_b):
        rot_b, kept = _frame(tree, plane, b, candidate.rot_b)
        half_b = candidate.half_b[kept]
    if candidate.kind == ContactKind.CORNER_BOX:
        rot_a, _ = _frame(tree, plane, a, candidate.rot_a)
    axis_a = _section(plane.local(tree, a, candidate.axis_a))
    if candidate.kind == ContactKind.OVAL_PLANE:  # its outline is an ellipse
        flat = np.column_stack([plane.local(tree, a, axis) for axis in np.eye(3)])
        rot_a = flat @ candidate.rot_a @ flat.T
        squares, axes = np.linalg.eigh(rot_a)
        axis_a = np.sqrt(squares[1]) * axes[:, 1]
    image = candidate._replace(
        pos_a=plane.local(tree, a, candidate.pos_a),
        axis_a=axis_a,
        pos_b=plane.local(tree, b, candidate.pos_b),
        axis_b=_section(plane.local(tree, b, candidate.axis_b)),
        rot_a=rot_a,
        rot_b=rot_b,
        half_b=half_b,
    )
    if candidate.kind != ContactKind.SEGMENT_SEGMENT:
        return image
    if not np.any(image.axis_a):  # a capsule along the normal is a point, and the point comes first
        return image._replace(kind=ContactKind.POINT_SHAPE)
    if not np.any(image.axis_b) and b != WORLD:
        return _swapped(image)._replace(kind=ContactKind.POINT_SHAPE)
    return image


def _frame(tree: Tree, plane: PlaneOfMotion, body: int, rot: Array) -> tuple[Array, list[int]]:
    """Frame (2, 2) of a box's section, and which of its three axes those are."""
    across = int(np.argmax(np.abs(tree.turn(body, rot).T @ plane.axis)))
    kept = [k for k in range(3) if k != across]
    return np.column_stack([plane.local(tree, body, rot[:, k]) for k in kept]), kept


def _section(half: Array) -> Array:
    return half if np.linalg.norm(half) > _ALIGNED else np.zeros(2)


def _swapped(c: Candidate) -> Candidate:
    """The same candidate with A and B exchanged (no boxes)."""
    return c._replace(
        geoms=c.geoms[::-1],
        body_a=c.body_b,
        body_b=c.body_a,
        pos_a=c.pos_b,
        axis_a=c.axis_b,
        pos_b=c.pos_a,
        axis_b=c.axis_a,
        radius_a=c.radius_b,
        radius_b=c.radius_a,
    )
