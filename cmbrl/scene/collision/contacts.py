"""Contact candidates: points, segments, boxes, rims that may touch. Pairs that never can are dropped, with a reason."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.scene.collision.candidates import ROUND, between, of_field, of_hulls, on_plane
from cmbrl.scene.collision.contact_records import Candidate, ContactLaw, When
from cmbrl.scene.collision.height_fields import most_touches, read_field
from cmbrl.scene.collision.mixing import collision_pairs, pair_label
from cmbrl.scene.collision.near import false_pairs, near_pairs
from cmbrl.scene.collision.reach import Balls, height_range
from cmbrl.scene.collision.shapes import FIELD, Shape, read_shape, roundings, touches
from cmbrl.scene.collision.stand_ins import CONVEX, OWN, StandIn, stand_in
from cmbrl.scene.collision.surfaces import Surfaces
from cmbrl.scene.records import WORLD, Array, LeftOut, Tree
from cmbrl.scene.source.mjcf import name_of
from cmbrl.scene.source.support import Gate

_POINTWISE = ("sphere", "capsule", "box", "cylinder", "mesh", "ellipsoid")  # touch a plane as they are
_MOST_RARE = 4000  # pairs that come near in rare poses at most: a whole kitchen has more, and would take minutes
_FAR = {
    "near": "nearer than 2 cm in none of 400 random poses (--self-contact all keeps it)",
    "none": "bodies of one robot do not touch each other (--self-contact none)",
}
_FALSE = (
    "what stands in for them overlaps where they do not, in the initial pose or a fifth of random ones, "
    "or is 5 mm deeper"
)


class ContactBuilder:
    """Turns the pairs that MuJoCo would test into candidates, keeping those that can touch."""

    def __init__(
        self,
        model: mujoco.MjModel,
        tree: Tree,
        normal: Array | None,
        gate: Gate,
        outlines: bool = False,
        hulls: bool = True,
        keep_far: bool = False,
        self_contact: str = "near",
    ) -> None:
        """
        Args:
            normal: (3,) unit normal of the plane of motion; None for a spatial tree.
            outlines: contacts are planar too, so a cylinder becomes its outline in the plane of motion.
            hulls: rows may act as MuJoCo's, once they are closed; there convex shapes touch as they are.
            keep_far: keep candidates that can never touch, if their shapes are supported.
            self_contact: between bodies of one tree: "near" (where they come near in random poses), "all" or "none".
        """
        self.model, self.tree, self.normal, self.gate = model, tree, normal, gate
        self.outlines, self.hulls, self.keep_far, self.self_contact = outlines, hulls, keep_far, self_contact
        self.candidates: list[Candidate] = []
        self.dropped: list[LeftOut] = []
        self.stand_ins: dict[int, StandIn] = {}  #: of geoms that touch as something else
        self._shapes: dict[int, Shape] = {}
        self._roundings = roundings(model)
        self._balls = Balls(model, tree)
        self._names = [name_of(model, "geom", geom) for geom in range(model.ngeom)]
        self._roots: list[int] = model.body_rootid[model.geom_bodyid].tolist()  # by geom
        self._surfaces = Surfaces(model, gate)

    def build(self) -> None:
        """Fills ``candidates`` and ``dropped``; reports unsupported pairs to the gate."""
        pairs = list(collision_pairs(self.model))  # all, so that too many are told before any work
        near = self._near(pairs)
        false = self._false(pairs, near)
        rare = self.self_contact == "near" and sum(self._far(*pair, near) for pair in pairs) <= _MOST_RARE
        for first, second, pair in pairs:
            a, b = self._shape(first), self._shape(second)
            if a.kind == b.kind == "plane":
                continue
            if "plane" in (a.kind, b.kind):
                plane, other = (a, b) if a.kind == "plane" else (b, a)
                self._against_plane(other, plane, pair)
            elif FIELD in (a.kind, b.kind):
                field, other = (a, b) if a.kind == FIELD else (b, a)
                self._against_field(other, field, pair)
            elif self._far(first, second, pair, near):
                if rare:
                    self._where_closed(a, b, pair)
                else:
                    self._drop(a, b, _FAR[self.self_contact])
            elif (first, second) in false:
                hulls = self._of_hulls(a, b, self._surfaces.law(a.geom, b.geom, pair))
                self.candidates += hulls
                self._drop(a, b, f"{'where rows look ahead: ' if hulls else ''}{_FALSE}")
            else:
                self._between(a, b, pair)

    def _near(self, pairs: list[tuple[int, int, int]]) -> set[tuple[int, int]] | None:
        """Pairs of one robot's geoms to keep where rows look ahead; None: all."""
        if self.self_contact == "all" or self.keep_far:
            return None
        if self.self_contact == "none" or not any(self._one_tree(a, b) and pair < 0 for a, b, pair in pairs):
            return set()
        return near_pairs(self.model)

    def _far(self, first: int, second: int, pair: int, near: set[tuple[int, int]] | None) -> bool:
        """Whether they are of one robot and not among those to keep; an explicit pair always is."""
        return near is not None and pair < 0 and self._one_tree(first, second) and (first, second) not in near

    def _where_closed(self, a: Shape, b: Shape, pair: int) -> None:
        """What comes near in rare poses only, or where a motor pushes a joint through its soft limit.

        There it touches as in MuJoCo; rows that look ahead are taken to keep it apart.
        """
        before = len(self.candidates)
        self._between(a, b, pair)
        added = self.candidates[before:]
        self.candidates[before:] = [c._replace(when=When.CLOSED) for c in added if c.when != When.AHEAD]
        if added:
            self._drop(a, b, f"where rows look ahead: {_FAR[self.self_contact]}")

    def _false(self, pairs: list[tuple[int, int, int]], near: set[tuple[int, int]] | None) -> set[tuple[int, int]]:
        """Pairs that stand-ins would keep apart all the time."""
        shapes: dict[int, Shape] = {}
        for first, second, pair in pairs:
            a, b = self._shape(first), self._shape(second)
            if self._far(first, second, pair, near) or not {a.kind, b.kind} <= {*CONVEX} or {a.kind, b.kind} <= {*OWN}:
                continue
            shapes |= {shape.geom: self._simple(shape) for shape in (a, b) if shape.kind not in OWN}
        return false_pairs(self.model, shapes, self.tree.frames) if shapes else set()

    def _one_tree(self, first: int, second: int) -> bool:
        """Whether joints connect both geoms, which move."""
        return self._roots[first] == self._roots[second] != 0

    def _of_hulls(self, a: Shape, b: Shape, law: ContactLaw) -> list[Candidate]:
        """What touches as in MuJoCo where rows do not look ahead. In the plane of motion, what needs space for that."""
        flat = self.outlines and (not self.hulls or {a.kind, b.kind} <= {*OWN})  # own contacts are MuJoCo's there
        return [] if flat else of_hulls(a, b, law)

    def _across(self, body: int) -> Array | None:
        """Where contacts are planar, the normal (3,) of the plane of motion in the frame of ``body``."""
        return self._local(body, self.normal) if self.outlines and self.normal is not None else None

    def _local(self, body: int, direction: Array) -> Array:
        """A direction (3,) of the world in the frame of ``body``."""
        return self.tree.turn(body, np.eye(3)).T @ direction

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

    def _drop(self, a: Shape, b: Shape, why: str, count: int = 1) -> None:
        name = f"{self._names[a.geom]} - {self._names[b.geom]}"
        self.dropped.append(LeftOut("contact", name if count == 1 else f"{name} ({count} points)", why))

    def _against_plane(self, shape: Shape, plane: Shape, pair: int) -> None:
        label = pair_label(self.model, shape.geom, plane.geom)
        if plane.body != WORLD:
            self.gate.refuse("geom_type", label, "a plane on a moving body")
            return
        up = plane.rot[:, 2]
        ground = float(up @ plane.pos)
        law = self._surfaces.law(shape.geom, plane.geom, pair)
        if shape.kind not in _POINTWISE:
            low = height_range(self.model, self.tree, shape.body, shape.pos, up).low - shape.bound - ground
            if low > law.reach:
                self._drop(shape, plane, f"it stays at least {low:.3g} m away")
            else:
                self.gate.refuse("geom_type", label, f"contact with a geom of type {shape.kind}")
            return
        reasons: dict[str, int] = {}
        for touch in touches(shape, self._across(shape.body)):
            height = height_range(self.model, self.tree, shape.body, touch.pos, up)
            low = height.low - touch.reach - ground
            if height.constant and law.dim == 1 and low < law.reach:
                why = "no joint changes its distance and it has no friction"
            elif low >= law.reach and height.constant and not self.keep_far:
                why = "no joint changes its distance"
            elif low > law.reach and not self.keep_far:
                why = "it is out of reach"
            else:
                self.candidates.append(on_plane(shape, plane, touch, law))
                continue
            reasons[why] = reasons.get(why, 0) + 1
        for why, count in reasons.items():
            self._drop(shape, plane, why, count)

    def _against_field(self, shape: Shape, field: Shape, pair: int) -> None:
        label = pair_label(self.model, shape.geom, field.geom)
        if field.body != WORLD:
            self.gate.refuse("geom_type", label, "a height field on a moving body")
            return
        law, up = self._surfaces.law(shape.geom, field.geom, pair), field.rot[:, 2]
        heights = read_field(self.model, field.geom)
        height = height_range(self.model, self.tree, shape.body, shape.pos, up)
        above = height.low - shape.bound - float(up @ field.pos) - float(heights.heights.max())
        beside = self._balls.closest_approach(shape, field) - shape.bound - field.bound
        if max(above, beside) > law.reach and not self.keep_far:
            self._drop(shape, field, f"it stays at least {max(above, beside):.3g} m away")
        elif shape.kind not in CONVEX or not shape.sides:
            why = f"contact of a {shape.kind} with a height field"
            self.gate.refuse("geom_type", label, why if shape.sides else f"{why}: this MuJoCo keeps no sides of meshes")
        else:
            most = most_touches(self.model, shape.geom, shape.bound, heights)
            self.candidates += of_field(shape, field, law, most)

    def _between(self, a: Shape, b: Shape, pair: int) -> None:
        law = self._surfaces.law(a.geom, b.geom, pair)
        nearest = self._balls.closest_approach(a, b) - a.bound - b.bound
        kinds = {a.kind, b.kind}
        modelled = kinds <= {*OWN}
        if nearest > law.reach and not (self.keep_far and modelled):
            self._drop(a, b, f"they stay at least {nearest:.3g} m apart")
            return
        if self.normal is not None:  # motion in a plane keeps both at their distance along its normal
            offset = abs(self.normal @ (self.tree.place(a.body, a.pos) - self.tree.place(b.body, b.pos)))
            apart = offset - sum(s.reach_along(self._local(s.body, self.normal)) for s in (a, b))
            if apart > law.reach:
                self._drop(a, b, f"they move in parallel planes {apart:.3g} m apart")
                return
        if odd := kinds - {*CONVEX}:
            label = pair_label(self.model, a.geom, b.geom)
            self.gate.refuse("geom_type", label, f"contact with a geom of type {odd.pop()}")
            return
        if "geom_pair" in self.gate.ignore and not (kinds <= {*ROUND} or kinds == {"sphere", "box"}):
            label = pair_label(self.model, a.geom, b.geom)
            self.gate.refuse("geom_pair", label, f"contact of a {a.kind} with a {b.kind}")
            return
        hulls = self._of_hulls(a, b, law)
        first, second = self._simple(a), self._simple(b)
        box = next((shape for shape in (first, second) if shape.kind == "box"), None)
        when = When.AHEAD if hulls else When.ALWAYS
        self.candidates += [*hulls, *between(first, second, law, self._across(box.body) if box else None, when)]
