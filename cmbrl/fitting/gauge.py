"""Which mass must stay fixed, because motion alone does not determine the unit of force.

Scaling mass, armature, damping, stiffness, friction loss and gear of a tree together changes no motion. One known value
among them determines the others; if all may move, one mass has to stay fixed or the search diverges. Trees that can
touch exchange impulses, so they share one scale.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cmbrl.scene.core_arrays import CoreArrays
from cmbrl.scene.records import JointKind

_FORCES = ("armature", "damping", "stiffness", "frictionloss")  # fields of a degree of freedom, all but springref


def gauge_columns(core: CoreArrays, free: np.ndarray) -> list[int]:
    """The mass parameters to remove from ``free`` (n,) bool, one per set of trees with an undetermined unit of force.

    ``core`` is ``scene.core``. The heaviest body of a set keeps its mass, which is probably known best.
    """
    mass = core.layout.mass
    owner = parameters_by_place(core)
    held: list[int] = []
    for members in _sets(core):
        massive = [b for b in members if core.P[mass(b)] > 0.0]
        places = [mass(b) for b in massive] + _force_places(core, members)
        if massive and all(_free_owner(owner, place, free) is not None for place in places):
            heaviest = max(massive, key=lambda b: core.P[mass(b)])
            held.append(next(k for k in owner[mass(heaviest)] if free[k]))
    return held


def set_of(core: CoreArrays, column: int) -> list[int]:
    """All parameters that scale with the mass parameter ``column``: masses and forces of its set of trees."""
    owner = parameters_by_place(core)
    for members in _sets(core):
        places = [core.layout.mass(b) for b in members] + _force_places(core, members)
        together = sorted({k for place in places for k in owner.get(place, ())})
        if column in together:
            return together
    raise KeyError(column)


def parameters_by_place(core: CoreArrays) -> dict[int, list[int]]:
    """Offset into the physical vector P -> the parameters that move it."""
    owner: dict[int, list[int]] = {}
    ptr, idx = core.par_ptr, core.par_idx
    for k in range(len(ptr) - 1):
        for place in idx[ptr[k] : ptr[k + 1]]:
            owner.setdefault(int(place), []).append(k)
    return owner


def _free_owner(owner: Mapping[int, list[int]], place: int, free: np.ndarray) -> int | None:
    return next((k for k in owner.get(place, ()) if free[k]), None)


def _force_places(core: CoreArrays, members: list[int]) -> list[int]:
    """Offsets into P of every nonzero force on ``members`` that does not scale with gravity."""
    layout, dof_body = core.layout, np.full(core.nv, -1)
    for kind, body, dof in zip(core.jnt_type, core.jnt_body, core.jnt_vadr, strict=True):
        dof_body[dof : dof + (3 if kind == JointKind.BALL else 1)] = body
    inside = set(members)
    places = [layout.dof(d, field) for d in range(core.nv) if dof_body[d] in inside for field in _FORCES]
    pushed = [int(dof_body[dof]) for dof in core.act_dof]
    for k, actuator in enumerate(core.wide_act):
        dofs = core.wide_dof[core.wide_ptr[k] : core.wide_ptr[k + 1]]
        pushed[actuator] = int(dof_body[dofs[0]] if len(dofs) else core.wide_body[k])
    places += [layout.actuator(a, "gear") for a, body in enumerate(pushed) if body in inside]
    return [place for place in places if core.P[place] != 0.0]


def _sets(core: CoreArrays) -> list[list[int]]:
    """Lists of bodies that exchange impulses, through joints or contact."""
    root = list(range(core.nbody))

    def find(body: int) -> int:
        while root[body] != body:
            body = root[body]
        return body

    links = list(enumerate(core.body_parent)) + list(zip(core.con_bodyA, core.con_bodyB, strict=True))
    for a, b in links:
        if a >= 0 and b >= 0:
            root[find(int(a))] = find(int(b))
    members: dict[int, list[int]] = {}
    for body in range(len(root)):
        members.setdefault(find(body), []).append(body)
    return list(members.values())
