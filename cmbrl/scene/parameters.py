"""The numbers of a scene that can be fitted: their names, bounds, and effect on the physical vector.

P(theta) = P0 + sum_k (theta_k - nominal_k) D_k with sparse D_k. The nominal value of a scale is 1, of a shift 0.
Bounds are physical and generous: they keep a search sane and are not a prior.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.scene.actuators import Actuator
from cmbrl.scene.layout import Layout
from cmbrl.scene.mjcf import name_of
from cmbrl.scene.records import WORLD, Array, Candidate, Joint, JointKind, Parameter, Tree
from cmbrl.scene.shapes import Shape

Entries = Iterable[tuple[int, float]]

_SHARES = ("impedance_low", "impedance_high")  # between 0 and 1, searched on a logit scale

_UNITS = {  # for slides, for hinges and balls
    "damping": ("N s/m", "N m s/rad"),
    "armature": ("kg", "kg m^2"),
    "stiffness": ("N/m", "N m/rad"),
    "frictionloss": ("N", "N m"),
}

_LAW_FIELDS = {  # rigid: the time in which a penetration decays
    "rigid": (("solref0", "softness_time", "s"),),
    "mujoco": (("solref0", "softness_time", "s"), ("solref1", "softness_damping", "1")),
    "spring-damper": (("solref0", "contact_stiffness", "N/m"), ("solref1", "contact_damping", "N s/m")),
}

# MuJoCo's solimp: impedance at first touch, at depth ``width``, and that width. Bounds are those MuJoCo clips to.
_IMPEDANCE_FIELDS = (
    ("d0", "impedance_low", 0.001, 0.9999, "1"),
    ("dmax", "impedance_high", 0.001, 0.9999, "1"),
    ("width", "impedance_width", 1e-5, 0.1, "m"),
)


@dataclass(frozen=True)
class Moves:
    """Parameters and their columns D, compressed: entries ptr[k]:ptr[k+1] of idx and coef belong to parameter k."""

    parameters: tuple[Parameter, ...]
    ptr: np.ndarray
    idx: np.ndarray
    coef: Array


class _Collector:
    def __init__(self) -> None:
        self.parameters: list[Parameter] = []
        self.entries: list[list[tuple[int, float]]] = []

    def add(self, group: str, of: str, value: float, low: float, high: float, unit: str, entries: Entries) -> None:
        """Adds a parameter. Its transform is "log" for positive bounds, "logit" for impedances, otherwise "linear"."""
        name = f"{group}.{of}" if of else group
        transform = "linear" if low <= 0 else "logit" if group in _SHARES else "log"
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
    contact_law: str,
) -> Moves:
    """All parameters of a scene. ``letters`` name the axes of centres of mass; ``P`` (nP,) is the nominal vector."""
    out = _Collector()
    massive = [k for k in range(len(tree.bodies)) if P[layout.mass(k)] > 0]
    for k in massive:
        inertia = layout.inertia(k)
        moved = [layout.mass(k), *range(inertia, inertia + layout.inertia_fields)]
        out.scale("mass", tree.bodies[k].name, 0.2, 5.0, P, moved)
    for axis, letter in enumerate(letters):
        for k in massive:
            body = tree.bodies[k]
            size = 1.5 * float(
                np.sqrt(np.trace(body.inertia) / 2 / body.mass)
            )  # 1.7 radii of gyration reach the end of a rod
            if size > 0:
                out.add(f"com_{letter}", body.name, 0.0, -size, size, "m", [(layout.com(k) + axis, 1.0)])
    _joint_parameters(model, tree, layout, P, out)
    _contact_parameters(model, candidates, layout, P, contact_law, out)
    for k, ground in enumerate(planes):
        out.add("plane_height", name_of(model, "geom", ground.geom), 0.0, -0.1, 0.1, "m", [(layout.plane(k), 1.0)])
    for k, actuator in enumerate(actuators):
        if actuator.gear:
            out.scale("gear", actuator.name, 0.2, 5.0, P, [layout.actuator(k)])
    down = range(layout.gravity, layout.contact(0))
    if np.any(P[down]):
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
    """Joint parameters that are nonzero in the file, and zero damping and armature except on floating bases.

    The inertia M at qpos0 bounds those zeros: armature up to M, damping up to M times 5/s.
    """
    by_source: dict[int, list[Joint]] = {}
    for joint in tree.joints:
        by_source.setdefault(joint.source, []).append(joint)
    for field, rate in (("damping", 5.0), ("armature", 1.0), ("stiffness", 0.0), ("frictionloss", 0.0)):
        for joints in by_source.values():
            dofs = [d for joint in joints for d in joint.dofs]
            indices = [layout.dof(d, field) for d in dofs]
            value, name = float(P[indices[0]]), joints[0].name
            unit = _UNITS[field][int(joints[-1].kind != JointKind.SLIDE)]
            if value > 0:
                out.add(field, name, value, value / 20, value * 20, unit, [(i, 1.0) for i in indices])
            elif rate and not _floating(tree, joints[0]):
                out.add(
                    field, name, 0.0, 0.0, rate * float(model.dof_M0[dofs].max()), unit, [(i, 1.0) for i in indices]
                )


def _floating(tree: Tree, joint: Joint) -> bool:
    """Whether a joint places a body in space: a free joint, or one of several between a body and the world."""
    body = tree.bodies[joint.body]
    return body.parent == WORLD and len(body.joints) > 1


def _contact_parameters(
    model: mujoco.MjModel, candidates: list[Candidate], layout: Layout, P: Array, contact_law: str, out: _Collector
) -> None:
    """Friction and softness of each geom that touches the world; contacts between moving bodies share ``pairs``."""
    groups: dict[int, list[int]] = {}
    for k, c in enumerate(candidates):
        groups.setdefault(c.geoms[0] if c.body_b == WORLD else model.ngeom, []).append(k)

    def entries(rows: list[int], field: str) -> list[tuple[int, float]]:
        return [(layout.contact(k, field), 1.0) for k in rows]

    def by_value(rows: list[int], field: str) -> Iterator[tuple[str, float, list[int]]]:
        """Splits a group by nominal value; several values are told apart by the geoms of their first contact."""
        values = dict.fromkeys(float(P[layout.contact(k, field)]) for k in rows)
        for value in values:
            same = [k for k in rows if P[layout.contact(k, field)] == value]
            first = candidates[same[0]]
            told = first.geoms[1:] if first.body_b == WORLD else first.geoms
            suffix = ":" + "-".join(name_of(model, "geom", geom) for geom in told)
            yield suffix if len(values) > 1 else "", value, same

    for geom, rows in sorted(groups.items()):
        name = name_of(model, "geom", geom) if geom < model.ngeom else "pairs"
        for suffix, value, same in by_value([k for k in rows if candidates[k].law.dim > 1], "friction"):
            low, high = min(0.01, value / 2), max(5.0, 2 * value)
            out.add("friction", name + suffix, value, low, high, "1", entries(same, "friction"))
        if contact_law == "rigid":
            out.add("restitution", name, 0.0, 0.0, 1.0, "1", entries(rows, "restitution"))
        for field, group, unit in _LAW_FIELDS[contact_law]:
            for suffix, value, same in by_value(rows, field):
                if value > 0:  # a negative solref is a stiffness, which softness_scale covers
                    out.add(group, name + suffix, value, value / 10, value * 10, unit, entries(same, field))
        if contact_law == "mujoco":
            out.scale("softness_scale", name, 1e-3, 1e4, P, [layout.contact(k, "rscale") for k in rows])
            for field, group, low, high, unit in _IMPEDANCE_FIELDS:
                for suffix, value, same in by_value(rows, field):
                    if low <= value <= high:  # MuJoCo allows 0, which no scaling can change
                        out.add(group, name + suffix, value, low, high, unit, entries(same, field))
    rounded: dict[int, list[int]] = {}
    for k, c in enumerate(candidates):
        for geom, body in zip(c.geoms, (c.body_a, c.body_b), strict=True):
            if body != WORLD:
                rounded.setdefault(geom, []).append(k)
    for geom, rows in sorted(rounded.items()):
        sizes = model.geom_size[geom]
        size = 0.5 * float(sizes[sizes > 0].min(initial=0.04))
        out.add("radius", name_of(model, "geom", geom), 0.0, -size, size, "m", entries(rows, "radius"))
