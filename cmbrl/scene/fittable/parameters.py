"""The numbers of a scene that can be fitted: their names, bounds, and effect on the physical vector.

P(theta) = P0 + sum_k (theta_k - nominal_k) D_k with sparse D_k, then the shapes of inertias (``inertia_shapes``) and
the softness that masses give to contacts (``inverse_weights``). The nominal value of a scale is 1, of a shift 0.
Bounds are physical and generous: they keep a search sane and are not a prior.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.fittable.collector import Collector, Moves
from cmbrl.scene.fittable.fluid_parameters import offer_fluid
from cmbrl.scene.fittable.inertia_shapes import offer_shapes
from cmbrl.scene.fittable.joint_parameters import offer_actuator, offer_joints
from cmbrl.scene.fittable.tendon_parameters import offer_tendons
from cmbrl.scene.layout import Layout
from cmbrl.scene.parts import Parts
from cmbrl.scene.records import WORLD, Array
from cmbrl.scene.source.mjcf import name_of

Rows = NDArray[np.int64]

_LAW_FIELDS = {  # rigid: the time in which a penetration decays
    "rigid": (("solref0", "softness_time", "s"),),
    "mujoco": (("solref0", "softness_time", "s"), ("solref1", "softness_damping", "1")),
    "spring-damper": (("solref0", "contact_stiffness", "N/m"), ("solref1", "contact_damping", "N s/m")),
    "logistic": (("solref0", "activation_stiffness", "1/m"),),
}

_LOAD, _OUTSIDE = 2.5, 5.0  # reach of masses, to 56 times the file's, and of centres: a load far from a light link

TILT = "gravity_tilt"  #: how far gravity leans: a table that is not level, a base that is not mounted as in the file
_LEVEL, _CROOKED = 0.05, 6.0  # [rad]: 3 degrees are expected, and 17 possible

_LIVELY = 2.0  # reach of softness: a ball that keeps 3/4 of its energy has a damping ratio of .05

# MuJoCo's solimp: impedance at first touch, at depth ``width``, and that width. Bounds are those MuJoCo clips to.
_IMPEDANCE_FIELDS = (
    ("d0", "impedance_low", 0.001, 0.9999, "1"),
    ("dmax", "impedance_high", 0.001, 0.9999, "1"),
    ("width", "impedance_width", 1e-5, 0.1, "m"),
)

# Torsional and rolling friction with the least condim that has them, by dimension of the scene: no spin in the plane.
_ROLL = ("roll", "rolling_friction", 6)
_TURNING_FIELDS = {2: (_ROLL,), 3: (("spin", "torsional_friction", 4), _ROLL)}


def offer_parameters(
    model: mujoco.MjModel, parts: Parts, layout: Layout, letters: tuple[str, ...], P: Array, contact_law: str
) -> tuple[Moves, dict[str, Any]]:
    """All parameters of a scene, and the core's arrays of shapes.

    ``letters`` name the axes of centres of mass; ``P`` (nP,) is the nominal vector.
    """
    out, tree = Collector(), parts.tree
    massive = [k for k in range(len(tree.bodies)) if P[layout.mass(k)] > 0]
    masses = {}
    for k in massive:
        inertia = layout.inertia(k)
        moved = [layout.mass(k), *range(inertia, inertia + layout.inertia_fields)]
        masses[k] = out.scale("mass", tree.bodies[k].name, 0.2, 5.0, P, moved, reach=_LOAD)
    for axis, letter in enumerate(letters):
        for k in massive:
            body = tree.bodies[k]
            size = 1.5 * float(
                np.sqrt(np.trace(body.inertia) / 2 / body.mass)
            )  # 1.7 radii of gyration reach the end of a rod
            if size > 0:
                out.add(f"com_{letter}", body.name, 0.0, -size, size, "m", [layout.com(k) + axis], reach=_OUTSIDE)
    shapes = offer_shapes(tree, massive, masses, layout, P, out)
    offer_joints(model, tree, parts.actuators, layout, P, out)
    offer_tendons(model, tree, parts.tendons, parts.actuators, layout, P, out)
    _contact_parameters(model, parts.candidates, layout, P, contact_law, out)
    for k, ground in enumerate(parts.grounds):
        out.add("plane_height", name_of(model, "geom", ground.geom), 0.0, -0.1, 0.1, "m", [layout.plane(k)])
    for k, actuator in enumerate(parts.actuators):
        offer_actuator(tree, actuator, layout, k, out)
    offer_fluid(parts, layout, P, out)
    _offer_gravity(layout, letters, P, out)
    return out.moves(), shapes


def _offer_gravity(layout: Layout, letters: tuple[str, ...], P: Array, out: Collector) -> None:
    """Its size, and how far it leans towards the other axes of the world: known, unless the base is crooked."""
    down = range(layout.gravity, layout.contact(0))
    size = float(np.linalg.norm(P[down]))
    if not size:
        return
    out.scale("gravity", "", 0.5, 2.0, P, down, default=False)
    along = P[down] / size
    for k, letter in enumerate(letters):
        if k != int(np.abs(along).argmax()):
            towards = np.eye(len(along))[k] - along[k] * along
            out.add(TILT, letter, 0.0, -_LEVEL, _LEVEL, "rad", down, size * towards, default=False, reach=_CROOKED)


def _contact_parameters(
    model: mujoco.MjModel, candidates: CandidateTable, layout: Layout, P: Array, contact_law: str, out: Collector
) -> None:
    """Friction and softness of each geom that touches the world; contacts between moving bodies share ``pairs``."""
    world = candidates.bodies == WORLD
    geoms = np.where(world[:, :1], candidates.geoms[:, ::-1], candidates.geoms)  # what moves comes first
    on_world: NDArray[np.bool_] = np.any(world, axis=1)
    dims = candidates.of_laws("dim")

    def by_value(rows: Rows, field: str) -> Iterator[tuple[str, float, Rows]]:
        """Splits a group by nominal value; several values are told apart by the geoms of their first contact."""
        values, first, which = np.unique(P[layout.contacts(rows, field)], return_index=True, return_inverse=True)
        for k in np.argsort(first):
            same = rows[which == k]
            told = geoms[same[0], int(on_world[same[0]]) :]
            suffix = ":" + "-".join(name_of(model, "geom", int(geom)) for geom in told)
            yield suffix if len(values) > 1 else "", float(values[k]), same

    for geom, rows in _by_key(np.where(on_world, geoms[:, 0], model.ngeom)):
        name = name_of(model, "geom", geom) if geom < model.ngeom else "pairs"
        for suffix, value, same in by_value(rows[dims[rows] > 1], "friction"):
            low, high = min(0.01, value / 2), max(5.0, 2 * value)
            out.add("friction", name + suffix, value, low, high, "1", layout.contacts(same, "friction"))
        for field, group, least in _TURNING_FIELDS[layout.dimension]:
            for suffix, value, same in by_value(rows[dims[rows] >= least], field):
                places = layout.contacts(same, field)
                out.add(group, name + suffix, value, value / 100, value * 100, "m", places, default=False)
        if contact_law == "rigid":
            out.add("restitution", name, 0.0, 0.0, 1.0, "1", layout.contacts(rows, "restitution"))
        for field, group, unit in _LAW_FIELDS[contact_law]:
            for suffix, value, same in by_value(rows, field):
                if value > 0:  # a negative solref is a stiffness, which softness_scale covers
                    places = layout.contacts(same, field)
                    out.add(group, name + suffix, value, value / 100, value * 100, unit, places, reach=_LIVELY)
        if contact_law == "mujoco":
            out.scale("softness_scale", name, 1e-3, 1e4, P, layout.contacts(rows, "rscale"))
            for field, group, low, high, unit in _IMPEDANCE_FIELDS:
                for suffix, value, same in by_value(rows, field):
                    if low <= value <= high:  # MuJoCo allows 0, which no scaling can change
                        out.add(group, name + suffix, value, low, high, unit, layout.contacts(same, field))
    moving = np.column_stack([geoms[:, 0], np.where(on_world, -1, geoms[:, 1])])
    for geom, sides in _by_key(moving.ravel()):
        if geom < 0:
            continue
        sizes = model.geom_size[geom]
        size = 0.5 * float(sizes[sizes > 0].min(initial=0.04))
        out.add("radius", name_of(model, "geom", geom), 0.0, -size, size, "m", layout.contacts(sides // 2, "radius"))


def _by_key(keys: Rows) -> Iterator[tuple[int, Rows]]:
    """Each key, rising, with the rows that have it, rising."""
    order = np.argsort(keys, kind="stable")
    values, first = np.unique(keys[order], return_index=True)
    ends = np.append(first[1:], len(keys))
    for k, value in enumerate(values):
        yield int(value), order[first[k] : ends[k]]
