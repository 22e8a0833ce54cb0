"""Contact candidates: points, segments, boxes, rims that may touch. Pairs that never can are dropped, with a reason."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from cmbrl.scene.hulls import has_sides
from cmbrl.scene.mixing import collision_pairs, contact_law, inverse_weight, pair_label
from cmbrl.scene.near import false_pairs, near_pairs
from cmbrl.scene.reach import Balls, height_range
from cmbrl.scene.records import WORLD, Array, Candidate, ContactKind, ContactLaw, LeftOut, Tree, When
from cmbrl.scene.shapes import Shape, Touch, read_shape, roundings, touches
from cmbrl.scene.stand_ins import CONVEX, OWN, StandIn, stand_in
from cmbrl.scene.support import Gate

_POINTWISE = ("sphere", "capsule", "box", "cylinder", "mesh")  # touch a plane as they are
_ROUND = ("sphere", "capsule")
_SURFACE = (
    "geom_condim", "geom_priority", "geom_solmix", "geom_friction", "geom_solref", "geom_solimp", "geom_margin",
    "geom_gap", "geom_adhesion", "geom_surfacevel",
)  # fmt: skip
_FAR = {
    "near": "nearer than 2 cm in none of 400 random poses (--self-contact all keeps it)",
    "none": "bodies of one robot do not touch each other (--self-contact none)",
}
_FALSE = (
    "what stands in for them overlaps where they do not, in the initial pose or a fifth of random ones, "
    "or is 5 mm deeper"
)
_ZERO, _UPRIGHT = np.zeros(3), np.eye(3)  # shared by all candidates


class ContactBuilder:
    """Turns the pairs that MuJoCo would test into candidates, keeping those that can touch."""

    def __init__(
        self,
        model: mujoco.MjModel,
        tree: Tree,
        normal: Array | None,
        gate: Gate,
        outlines: bool = False,
        keep_far: bool = False,
        self_contact: str = "near",
    ) -> None:
        """
        Args:
            normal: (3,) unit normal of the plane of motion; None for a spatial tree.
            outlines: contacts are planar too, so a cylinder becomes its outline in the plane of motion.
            keep_far: keep candidates that can never touch, if their shapes are supported.
            self_contact: between bodies of one tree: "near" (where they come near in random poses), "all" or "none".
        """
        self.model, self.tree, self.normal, self.gate = model, tree, normal, gate
        self.outlines, self.keep_far, self.self_contact = outlines, keep_far, self_contact
        self.candidates: list[Candidate] = []
        self.dropped: list[LeftOut] = []
        self.stand_ins: dict[int, StandIn] = {}  #: of geoms that touch as something else
        self._shapes: dict[int, Shape] = {}
        self._roundings = roundings(model)
        self._balls = Balls(model, tree)
        self._laws: dict[tuple[bytes, bytes], ContactLaw] = {}
        self._surfaces: dict[int, bytes] = {}

    def build(self) -> None:
        """Fills ``candidates`` and ``dropped``; reports unsupported pairs to the gate."""
        pairs = list(collision_pairs(self.model))  # all, so that too many are told before any work
        near, pushed = self._near(pairs)
        false = self._false(pairs, near)
        for first, second, pair in pairs:
            a, b = self._shape(first), self._shape(second)
            if a.kind == b.kind == "plane":
                continue
            if "plane" in (a.kind, b.kind):
                plane, other = (a, b) if a.kind == "plane" else (b, a)
                self._against_plane(other, plane, pair)
            elif near is not None and pair < 0 and self._one_tree(first, second) and (first, second) not in near:
                if (first, second) in pushed:
                    self._where_closed(a, b, pair)
                else:
                    self._drop(a, b, _FAR[self.self_contact])
            elif (first, second) in false:
                hulls = self._hulls(a, b, self._law(a, b, pair))
                self.candidates += hulls
                self._drop(a, b, f"{'where rows look ahead: ' if hulls else ''}{_FALSE}")
            else:
                self._between(a, b, pair)

    def _near(self, pairs: list[tuple[int, int, int]]) -> tuple[set[tuple[int, int]] | None, set[tuple[int, int]]]:
        """Pairs of one robot's geoms to keep (None: all), and those to keep where rows do not look ahead."""
        if self.self_contact == "all" or self.keep_far:
            return None, set()
        if self.self_contact == "none" or not any(self._one_tree(a, b) and pair < 0 for a, b, pair in pairs):
            return set(), set()
        return near_pairs(self.model)

    def _where_closed(self, a: Shape, b: Shape, pair: int) -> None:
        """Limits that look ahead keep links apart that MuJoCo's let through to each other."""
        before = len(self.candidates)
        self._between(a, b, pair)
        added = self.candidates[before:]
        self.candidates[before:] = [replace(c, when=When.CLOSED) for c in added if c.when != When.AHEAD]
        if added:
            self._drop(a, b, f"where rows look ahead: {_FAR[self.self_contact]}")

    def _false(self, pairs: list[tuple[int, int, int]], near: set[tuple[int, int]] | None) -> set[tuple[int, int]]:
        """Pairs that stand-ins would keep apart all the time."""
        shapes: dict[int, Shape] = {}
        for first, second, pair in pairs:
            a, b = self._shape(first), self._shape(second)
            far = near is not None and pair < 0 and self._one_tree(first, second) and (first, second) not in near
            if far or not {a.kind, b.kind} <= {*CONVEX} or {a.kind, b.kind} <= {*OWN}:
                continue
            shapes |= {shape.geom: self._simple(shape) for shape in (a, b) if shape.kind not in OWN}
        return false_pairs(self.model, shapes, self.tree.frames) if shapes else set()

    def _one_tree(self, first: int, second: int) -> bool:
        """Whether joints connect both geoms, which move."""
        root = self.model.body_rootid[self.model.geom_bodyid[[first, second]]]
        return bool(root[0] == root[1] and root[0] != 0)

    def _hulls(self, a: Shape, b: Shape, law: ContactLaw) -> list[Candidate]:
        """What touches as in MuJoCo where rows do not look ahead: all but spheres, capsules and boxes among themselves.

        Only closed gaps are seen. Of two boxes in space, edges that cross wherever they are: corners alone would let
        them through each other.
        """
        kinds, boxes = {a.kind, b.kind}, a.kind == b.kind == "box"
        if not kinds <= {*CONVEX} or (kinds <= {*OWN} and not boxes) or law.margin > 0:
            return []
        if self.normal is not None and kinds != {"mesh"} and kinds != {"mesh", "box"}:
            return []
        if not (has_sides(self.model, a.geom) and has_sides(self.model, b.geom)) or a.rounding or b.rounding:
            return []
        a, b = (b, a) if a.body == WORLD else (a, b)
        kind, geoms, when = ContactKind.HULLS, (a.geom, b.geom), When.ALWAYS if boxes else When.CLOSED
        one = Candidate(
            kind, geoms, a.body, b.body, a.pos, _ZERO, b.pos, _ZERO, _UPRIGHT, _ZERO, 0.0, 0.0, law, when=when,
        )  # fmt: skip
        return [one] * _most_points(kinds)

    def _across(self, box: Shape) -> Array | None:
        """In a plane of motion, its normal in the frame of the box's body: only edges along it are seen there."""
        if not self.outlines or self.normal is None:
            return None
        return self.tree.turn(box.body, np.eye(3)).T @ self.normal

    def _simple(self, shape: Shape) -> Shape:
        """A sphere, capsule or box: the shape itself, or what stands in for it."""
        if shape.kind in OWN:
            return shape
        if shape.geom not in self.stand_ins:
            self.stand_ins[shape.geom] = stand_in(shape)
        return self.stand_ins[shape.geom].shape

    def _shape(self, geom: int) -> Shape:
        if geom not in self._shapes:
            self._shapes[geom] = read_shape(self.model, geom, self.tree.frames, self._roundings.get(geom, 0.0))
        return self._shapes[geom]

    def _law(self, a: Shape, b: Shape, pair: int) -> ContactLaw:
        """One record for all pairs of the same surfaces, unless there is something to report about each of them."""
        if pair >= 0:
            return self._mixed(a, b, pair)
        first, second = sorted((a.geom, b.geom))
        key = self._surface(first), self._surface(second)
        if key not in self._laws:
            before = self.gate.reports
            law = self._mixed(a, b, pair)
            if self.gate.reports > before:
                return law
            self._laws[key] = law
        return self._laws[key]

    def _surface(self, geom: int) -> bytes:
        """All that a law takes from one of its geoms."""
        if geom not in self._surfaces:
            fields = [name for name in _SURFACE if hasattr(self.model, name)]
            numbers = [np.ravel(getattr(self.model, name)[geom]).astype(float) for name in fields]
            weight = inverse_weight(self.model, int(self.model.geom_bodyid[geom]))
            self._surfaces[geom] = np.concatenate([*numbers, [weight]]).tobytes()
        return self._surfaces[geom]

    def _mixed(self, a: Shape, b: Shape, pair: int) -> ContactLaw:
        model, label = self.model, pair_label(self.model, a.geom, b.geom)
        for field, kind, rows in (
            ("geom_adhesion", "adhesion", [a.geom, b.geom]),
            ("pair_adhesion", "adhesion", [pair] if pair >= 0 else []),
            ("geom_surfacevel", "surface_velocity", [a.geom, b.geom]),
        ):
            values = getattr(model, field, None)  # fields of recent MuJoCo versions
            if values is not None and rows and np.any(np.asarray(values)[rows]):
                self.gate.refuse(kind, label, f"nonzero {field.split('_')[1]}")
        first, second = sorted((a.geom, b.geom))
        return contact_law(model, first, second, pair, self.gate)

    def _drop(self, a: Shape, b: Shape, why: str, count: int = 1) -> None:
        name = pair_label(self.model, a.geom, b.geom)
        self.dropped.append(LeftOut("contact", name if count == 1 else f"{name} ({count} points)", why))

    def _against_plane(self, shape: Shape, plane: Shape, pair: int) -> None:
        label = pair_label(self.model, shape.geom, plane.geom)
        if plane.body != WORLD:
            self.gate.refuse("geom_type", label, "a plane on a moving body")
            return
        up = plane.rot[:, 2]
        ground = float(up @ plane.pos)
        law = self._law(shape, plane, pair)
        if shape.kind == "ellipsoid":
            shape = self._simple(shape)
        if shape.kind not in _POINTWISE:
            low = height_range(self.model, self.tree, shape.body, shape.pos, up).low - shape.bound - ground
            if low > law.margin:
                self._drop(shape, plane, f"it stays at least {low:.3g} m away")
            else:
                self.gate.refuse("geom_type", label, f"contact with a geom of type {shape.kind}")
            return
        axis = None
        if self.outlines and self.normal is not None:
            axis = self.tree.turn(shape.body, np.eye(3)).T @ self.normal
        reasons: dict[str, int] = {}
        for touch in touches(shape, axis):
            height = height_range(self.model, self.tree, shape.body, touch.pos, up)
            low = height.low - touch.reach - ground
            if height.constant and law.dim == 1 and low < law.margin:
                why = "no joint changes its distance and it has no friction"
            elif low >= law.margin and height.constant and not self.keep_far:
                why = f"no joint changes its distance of {low:.3g} m"
            elif low > law.margin and not self.keep_far:
                why = "it is out of reach"
            else:
                self.candidates.append(_on_plane(shape, plane, touch, law))
                continue
            reasons[why] = reasons.get(why, 0) + 1
        for why, count in reasons.items():
            self._drop(shape, plane, why, count)

    def _between(self, a: Shape, b: Shape, pair: int) -> None:
        law = self._law(a, b, pair)
        nearest = self._balls.closest_approach(a, b) - a.bound - b.bound
        kinds = {a.kind, b.kind}
        modelled = kinds <= {*OWN}
        if nearest > law.margin and not (self.keep_far and modelled):
            self._drop(a, b, f"they stay at least {nearest:.3g} m apart")
            return
        if self.normal is not None:  # motion in a plane keeps both at their distance along its normal
            offset = abs(self.normal @ (self.tree.place(a.body, a.pos) - self.tree.place(b.body, b.pos)))
            apart = offset - sum(s.reach_along(self.tree.turn(s.body, np.eye(3)).T @ self.normal) for s in (a, b))
            if apart > law.margin:
                self._drop(a, b, f"they move in parallel planes {apart:.3g} m apart")
                return
        if odd := kinds - {*CONVEX}:
            label = pair_label(self.model, a.geom, b.geom)
            self.gate.refuse("geom_type", label, f"contact with a geom of type {odd.pop()}")
            return
        if "geom_pair" in self.gate.ignore and not (kinds <= {*_ROUND} or kinds == {"sphere", "box"}):
            label = pair_label(self.model, a.geom, b.geom)
            self.gate.refuse("geom_pair", label, f"contact of a {a.kind} with a {b.kind}")
            return
        hulls = self._hulls(a, b, law)
        simple = self._simply(self._simple(a), self._simple(b), law)
        self.candidates += [*hulls, *(replace(c, when=When.AHEAD) if hulls else c for c in simple)]

    def _simply(self, a: Shape, b: Shape, law: ContactLaw) -> list[Candidate]:
        """Of two spheres, capsules or boxes."""
        if a.kind in _ROUND and b.kind in _ROUND:
            return [_round_pair(a, b, law)]
        if a.kind == b.kind:
            return [*_corners(a, b, law), *_corners(b, a, law)]
        ball, box = (a, b) if a.kind in _ROUND else (b, a)
        return _round_box(ball, box, law, self._across(box))


def _most_points(kinds: set[str]) -> int:
    """Of MuJoCo's contact of two convex shapes."""
    if kinds == {"box"}:
        return 8
    return 1 if kinds & {"sphere", "ellipsoid"} else 4


def _on_plane(shape: Shape, plane: Shape, touch: Touch, law: ContactLaw) -> Candidate:
    kind = ContactKind.RIM_PLANE if np.any(touch.rim) else ContactKind.POINT_PLANE
    return Candidate(
        kind, (shape.geom, plane.geom), shape.body, WORLD,
        touch.pos, touch.rim, _ZERO, _ZERO, _UPRIGHT, _ZERO, touch.radius, 0.0, law, touch.weight,
        along=shape.rot[:, 2] if shape.kind == "capsule" else _ZERO,
    )  # fmt: skip


def _round_pair(a: Shape, b: Shape, law: ContactLaw) -> Candidate:
    """Spheres and capsules: a point of A against a segment of B, or two segments; B may be the world."""
    if WORLD in (a.body, b.body):
        a, b = (b, a) if a.body == WORLD else (a, b)
    elif a.kind == "capsule" and b.kind == "sphere":
        a, b = b, a
    kind = ContactKind.SEGMENT_SEGMENT if a.kind == "capsule" else ContactKind.POINT_SHAPE
    return Candidate(
        kind, (a.geom, b.geom), a.body, b.body,
        a.pos, a.axis, b.pos, b.axis, _UPRIGHT, _ZERO, a.radius, b.radius, law,
    )  # fmt: skip


def _point_box(shape: Shape, point: Array, radius: float, box: Shape, law: ContactLaw) -> Candidate:
    return Candidate(
        ContactKind.POINT_SHAPE, (shape.geom, box.geom), shape.body, box.body,
        point, _ZERO, box.pos, _ZERO, box.rot, box.core, radius, box.radius, law,
    )  # fmt: skip


def _corners(a: Shape, b: Shape, law: ContactLaw) -> list[Candidate]:
    """The corners of box A against box B."""
    points = [touch.pos for touch in touches(a, None)]
    return [
        replace(_point_box(a, p, a.radius, b, law), kind=ContactKind.CORNER_BOX, axis_a=p - a.pos, rot_a=a.rot)
        for p in points
    ]


def _round_box(ball: Shape, box: Shape, law: ContactLaw, across: Array | None) -> list[Candidate]:
    """A sphere, or both ends of a capsule, against a box; a capsule's side against its edges, or those ``across``."""
    if ball.kind == "sphere":
        return [_point_box(ball, ball.pos, ball.radius, box, law)]
    ends = [_point_box(ball, ball.pos + end * ball.axis, ball.radius, box, law) for end in (-1, 1)]
    edges = _edges(box)
    if across is not None:
        edges = [edge for edge in edges if abs(edge.rot[:, 2] @ across) > 1 - 1e-6] or edges
    return ends + [_round_pair(ball, edge, law) for edge in edges]


def _edges(box: Shape) -> list[Shape]:
    """The twelve edges as capsules without a radius, or with that of the box's rounding."""
    found = []
    for axis in range(3):
        turn = box.rot[:, [(axis + 1) % 3, (axis + 2) % 3, axis]]
        half = box.core[[(axis + 1) % 3, (axis + 2) % 3, axis]]
        for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            pos = box.pos + turn @ np.array([x * half[0], y * half[1], 0.0])
            size = np.array([box.rounding, half[2], 0.0])
            found.append(replace(box, kind="capsule", pos=pos, rot=turn, size=size, rounding=0.0))
    return found
