"""The numbers of a scene that can be fitted, by name, and how each moves the physical vector.

P(theta) = P0 + sum_k (theta_k - nominal_k) D_k with sparse D_k: scales have nominal 1, shifts 0, the others their value.
Bounds are physical and generous: they keep a search sane and are no prior.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.scene.actuators import Actuator
from cmbrl.scene.layout import Layout
from cmbrl.scene.mjcf import name_of
from cmbrl.scene.records import BALL, WORLD, Array, Candidate, Joint, Parameter, Tree
from cmbrl.scene.shapes import Shape

Entries = Iterable[tuple[int, float]]


@dataclass(frozen=True)
class Moves:
    """Parameters with the columns D in compressed form: entries ptr[k]:ptr[k+1] of idx and coef belong to parameter k."""

    parameters: tuple[Parameter, ...]
    ptr: np.ndarray
    idx: np.ndarray
    coef: Array


class _Collector:
    def __init__(self) -> None:
        self.parameters: list[Parameter] = []
        self.entries: list[list[tuple[int, float]]] = []
        self._names: set[str] = set()

    def add(self, group: str, of: str, value: float, low: float, high: float, unit: str, entries: Entries) -> None:
        """Adds a parameter; its transform is "log" where only positive values make sense, else "linear"."""
        name, count = (f"{group}.{of}" if of else group), 1
        while name in self._names:  # two elements of one name, say of two tendons' worth of unnamed geoms
            count += 1
            name = f"{group}.{of}_{count}"
        self._names.add(name)
        transform = "log" if low > 0 else "linear"
        self.parameters.append(Parameter(name, group, value, low, high, transform, unit))
        self.entries.append(list(entries))

    def scale(self, group: str, of: str, low: float, high: float, P: Array, indices: Iterable[int]) -> None:
        self.add(group, of, 1.0, low, high, "1", [(i, float(P[i])) for i in indices])


def offer_parameters(
    model: mujoco.MjModel,
    tree: Tree,
    candidates: list[Candidate],
    planes: list[Shape],
    actuators: list[Actuator],
    layout: Layout,
    letters: tuple[str, ...],
    P: Array,
    rigid: bool,
) -> Moves:
    """All parameters of a scene; ``letters`` name the axes of centres of mass, ``P`` (nP,) is the nominal vector."""
    out = _Collector()
    massive = [k for k in range(len(tree.bodies)) if P[layout.mass(k)] > 0]
    for k in massive:
        inertia = layout.inertia(k)
        moved = [layout.mass(k), *range(inertia, inertia + layout.inertia_fields)]
        out.scale("mass", tree.bodies[k].name, 0.2, 5.0, P, moved)
    for axis, letter in enumerate(letters):
        for k in massive:
            body = tree.bodies[k]
            size = 1.5 * float(np.sqrt(np.trace(body.inertia) / 2 / body.mass))  # gyration: 1.7 of it reach a rod's end
            if size > 0:
                out.add(f"com_{letter}", body.name, 0.0, -size, size, "m", [(layout.com(k) + axis, 1.0)])
    _joint_parameters(model, tree, layout, P, out)
    _contact_parameters(model, candidates, layout, P, rigid, out)
    for k, ground in enumerate(planes):
        out.add("plane_height", name_of(model, "geom", ground.geom), 0.0, -0.1, 0.1, "m", [(layout.plane(k), 1.0)])
    for k, actuator in enumerate(actuators):
        if actuator.gear:
            out.scale("gear", actuator.name, 0.2, 5.0, P, [layout.actuator(k)])
    down = range(layout.gravity, layout.size)
    if np.any(P[layout.gravity :]):
        out.scale("gravity", "", 0.5, 2.0, P, down)
    counts = [len(entries) for entries in out.entries]
    flat = [entry for entries in out.entries for entry in entries]
    return Moves(
        tuple(out.parameters),
        np.cumsum([0, *counts]).astype(np.int32),
        np.array([i for i, _ in flat], dtype=np.int32),
        np.array([c for _, c in flat], dtype=np.float64),
    )


def _joint_parameters(model: mujoco.MjModel, tree: Tree, layout: Layout, P: Array, out: _Collector) -> None:
    """Damping, armature, stiffness and friction loss. Zero damping and armature are offered too, but not on a floating base."""
    by_source: dict[int, list[Joint]] = {}
    for joint in tree.joints:
        by_source.setdefault(joint.source, []).append(joint)
    weights = np.zeros(model.nv)
    weights[:] = model.dof_M0
    for field, unit, slack in (("damping", "s", 5.0), ("armature", "", 1.0), ("stiffness", "", 0.0), ("frictionloss", "", 0.0)):
        for joints in by_source.values():
            rotary = joints[-1].kind != 0
            dofs = [d for joint in joints for d in range(joint.vadr, joint.vadr + (3 if joint.kind == BALL else 1))]
            indices = [layout.dof(d, field) for d in dofs]
            value = float(P[indices[0]])
            mixed = np.any(P[indices] != value)  # a ball joint whose dofs the file cannot tell apart has one value
            name, unit = joints[0].name, _unit(field, rotary)
            if value > 0 and not mixed:
                out.add(field, name, value, value / 20, value * 20, unit, [(i, 1.0) for i in indices])
            elif slack and value == 0 and not mixed and not _floating(tree, joints[0]):
                high = slack * float(weights[dofs].max())
                out.add(field, name, 0.0, 0.0, high, unit, [(i, 1.0) for i in indices])


def _floating(tree: Tree, joint: Joint) -> bool:
    """Whether a joint places a body in space (free, or one of several on a body that hangs from the world)."""
    body = tree.bodies[joint.body]
    return body.parent == WORLD and len(body.joints) > 1


def _unit(field: str, rotary: bool) -> str:
    if field == "armature":
        return "kg m^2" if rotary else "kg"
    force = "N m" if rotary else "N"
    per = {"damping": " s", "stiffness": "", "frictionloss": ""}[field]
    over = {"damping": "/rad" if rotary else "/m", "stiffness": "/rad" if rotary else "/m", "frictionloss": ""}[field]
    return f"{force}{per}{over}"


def _contact_parameters(
    model: mujoco.MjModel, candidates: list[Candidate], layout: Layout, P: Array, rigid: bool, out: _Collector
) -> None:
    """Per geom that touches the world; all contacts between moving bodies share ``pairs``, radii belong to geoms."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for k, c in enumerate(candidates):
        groups.setdefault((c.geoms[0],) if c.body_b == WORLD else (), []).append(k)
    named = [(name_of(model, "geom", key[0]) if key else "pairs", rows) for key, rows in sorted(groups.items(), key=_last)]
    for name, rows in named:
        rubbing = [k for k in rows if candidates[k].law.dim > 1]
        for value in sorted({candidates[k].law.friction for k in rubbing}):
            indices = [layout.contact(k) for k in rubbing if candidates[k].law.friction == value]
            low = min(0.01, value / 2)
            out.add("friction", name, value, low, max(5.0, 2 * value), "1", [(i, 1.0) for i in indices])
    if rigid:
        for name, rows in named:
            out.add("restitution", name, 0.0, 0.0, 1.0, "1", [(layout.contact(k, "restitution"), 1.0) for k in rows])
    else:
        for name, rows in named:
            for value in sorted({float(candidates[k].law.solref[0]) for k in rows}):
                same = [k for k in rows if candidates[k].law.solref[0] == value]
                if value > 0:  # negative: a stiffness, which softness_scale has to stand for
                    indices = [layout.contact(k, "solref0") for k in same]
                    out.add("softness_time", name, value, value / 10, value * 10, "s", [(i, 1.0) for i in indices])
        for name, rows in named:
            out.scale("softness_scale", name, 0.01, 100.0, P, [layout.contact(k, "rscale") for k in rows])
    rows_of: dict[int, list[tuple[int, float]]] = {}
    for k, c in enumerate(candidates):
        for geom, body in zip(c.geoms, (c.body_a, c.body_b), strict=True):
            if body != WORLD:
                rows_of.setdefault(geom, []).append((layout.contact(k, "radius"), 1.0))
    for geom, entries in sorted(rows_of.items()):
        size = 0.5 * float(model.geom_size[geom][model.geom_size[geom] > 0].min(initial=0.02))
        out.add("radius", name_of(model, "geom", geom), 0.0, -size, size, "m", entries)


def _last(item: tuple[tuple[int, ...], list[int]]) -> tuple[bool, tuple[int, ...]]:
    return not item[0], item[0]
