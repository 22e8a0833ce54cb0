"""Which mass must stay fixed, because motion alone does not tell the unit of force.

Scaling mass, armature, damping, stiffness, friction loss and gear of a tree together changes no motion. While one of
them is known, the others are measured against it; when all of them may move, one mass has to stay or the search runs
away. Trees that can touch each other exchange impulses, so they share one such scale.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cmbrl.scene.core_arrays import CoreArrays

FORCE_GROUPS = ("mass", "armature", "damping", "stiffness", "frictionloss", "gear")
_ARMATURE, _DAMPING, _STIFFNESS, _FRICTIONLOSS = 0, 1, 2, 4  # offsets in the five numbers of a degree of freedom
_DOF_FIELDS, _CONTACT_FIELDS, _ACTUATOR_FIELDS = 5, 9, 5


def gauge_columns(core: CoreArrays, free: np.ndarray) -> list[int]:
    """The mass parameters to leave out of ``free`` (n,) bool, one for each set of trees whose unit of force is open.

    Parameters: ``core`` is ``scene.core``. The heaviest body of a set keeps its mass: it is the best known one.
    """
    bodies = int(core.nbody)
    mass_at = np.arange(bodies) * _body_fields(core)
    owner = parameters_by_place(core)
    held: list[int] = []
    for members in _sets(core):
        massive = [b for b in members if core.P[mass_at[b]] > 0.0]  # a body that weighs nothing anchors nothing
        places = [int(mass_at[b]) for b in massive] + _force_places(core, members)
        if massive and all(_free_owner(owner, place, free) is not None for place in places):
            heaviest = max(massive, key=lambda b: core.P[mass_at[b]])
            held.append(next(k for k in owner[int(mass_at[heaviest])] if free[k]))
    return held


def set_of(core: CoreArrays, column: int) -> list[int]:
    """All parameters that scale with the mass parameter ``column``: the other masses and forces of its set of trees."""
    owner = parameters_by_place(core)
    for members in _sets(core):
        places = [b * _body_fields(core) for b in members] + _force_places(core, members)
        together = sorted({k for place in places for k in owner.get(place, ())})
        if column in together:
            return together
    raise KeyError(column)


def parameters_by_place(core: CoreArrays) -> dict[int, list[int]]:
    """Index in the physical vector P -> the parameters that move it."""
    owner: dict[int, list[int]] = {}
    ptr, idx = core.par_ptr, core.par_idx
    for k in range(len(ptr) - 1):
        for place in idx[ptr[k] : ptr[k + 1]]:
            owner.setdefault(int(place), []).append(k)
    return owner


def _free_owner(owner: Mapping[int, list[int]], place: int, free: np.ndarray) -> int | None:
    return next((k for k in owner.get(place, ()) if free[k]), None)


def _body_fields(core: CoreArrays) -> int:
    return 4 if core.planar else 10  # mass, centre of mass, inertia


def _force_places(core: CoreArrays, members: list[int]) -> list[int]:
    """Places in P of every force on ``members`` that acts at all (is not zero) and does not scale with gravity."""
    dofs_at = int(core.nbody) * _body_fields(core)
    actuators_at = dofs_at + int(core.nv) * _DOF_FIELDS + int(core.ncontact) * _CONTACT_FIELDS + int(core.nplane)
    dof_body = np.full(int(core.nv), -1)
    for kind, body, dof in zip(core.jnt_type, core.jnt_body, core.jnt_vadr, strict=True):
        dof_body[dof : dof + (3 if kind == 2 else 1)] = body
    inside = set(members)
    places = [
        dofs_at + d * _DOF_FIELDS + field
        for d in range(int(core.nv))
        if dof_body[d] in inside
        for field in (_ARMATURE, _DAMPING, _STIFFNESS, _FRICTIONLOSS)
    ]
    places += [actuators_at + a * _ACTUATOR_FIELDS for a, dof in enumerate(core.act_dof) if dof_body[dof] in inside]
    return [place for place in places if core.P[place] != 0.0]


def _sets(core: CoreArrays) -> list[list[int]]:
    """Bodies that exchange impulses, by joints or by contact, as lists of body indices."""
    root = list(range(int(core.nbody)))

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
