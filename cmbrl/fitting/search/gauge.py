"""Which parameters are known up to a common factor only, because motion does not determine the unit of force.

Scaling mass, armature, damping, stiffness, friction loss and gears, or gains, of a tree together, and the density and
viscosity of the fluid that it moves in, changes no motion. One known value among them determines the others; if all may
move, only the prior says how large they are: the factor is the one that leaves them nearest to the file. Holding one of
them instead would carry its error into all others. What the file does not have (a damping of 0, say) tells nothing of
the factor: its prior is as wide as the robot's masses and motors make it, in whatever unit, and that it is there at all
would speak for a small unit. Trees that can touch, or that a tendon or an equality constraint ties, exchange impulses,
so they share one scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from cmbrl.fitting.search.space import Space
from cmbrl.scene.core.core_arrays import CoreArrays
from cmbrl.scene.forces.fluid import drags
from cmbrl.scene.laws import CONTACT_LAWS
from cmbrl.scene.records import WORLD, JointKind, TieKind

_FORCES = ("armature", "damping", "stiffness", "frictionloss", "friction_slope", "stribeck")  # fields of a line
_SPRINGS = ("solref0", "solref1")  # fields of a contact, which hold its stiffness and damping
_GAINS = ("gain", "bias0", "bias1", "bias2")
_FELT = 0.1  # [m/s^2] of drag at 1 m/s: a fluid that is less felt, such as air, tells no masses
_FACTORS, _NARROWER = 40, 4  # tried at once; how often, each time between the neighbours of the best
_FURTHEST, _SWEEPS, _SETTLED = 10.0, 30, 1e-3


def common_factors(core: CoreArrays, free: np.ndarray) -> list[list[int]]:
    """Parameters among ``free`` (n,) bool that motion tells up to a common factor, by set of trees.

    ``core`` is ``scene.core``. A set of trees is left out if one of its masses or forces is known.
    """
    mass = core.layout.mass
    owner = parameters_by_place(core)
    found: list[list[int]] = []
    for members in _sets(core):
        massive = [b for b in members if core.P[mass(b)] > 0.0]
        forces = _force_places(core, members, owner)
        known = [*map(mass, massive), *(p for p in forces if core.P[p] != 0.0), *_felt(core, members)]
        owners = [owner.get(place, []) for place in known]
        if massive and all(any(free[k] for k in some) for some in owners):
            others = [
                owner.get(place, []) for place in [*forces, *_limit_places(core, members, owner), *_fluid_places(core)]
            ]
            found.append(sorted({k for some in [*owners, *others] for k in some if free[k]}))
    return found


def distance(space: Space, z: np.ndarray) -> np.ndarray:
    """Minus the logarithm of the prior of ``z`` (..., n), of those parameters that tell a unit of force."""
    own = np.where(space.nominal == 0.0, np.where(space.transform == "linear", 0.0, z), z)
    return np.asarray(0.5 * ((own @ space.precision) * own).sum(axis=-1))


def nearest(space: Space, z: np.ndarray, sets: list[list[int]]) -> np.ndarray:
    """``z`` (n,) with the parameters of each set times the factor that the prior asks for, inside the bounds.

    No motion changes by that. A fit ends before it gets there: along these factors its loss is flat.
    """
    for _ in range(_SWEEPS):  # what is alike in two sets ties their factors
        before = z
        for members in sets:
            z = _nearest(space, z, members)
        if np.abs(z - before).max() < _SETTLED:
            break
    return z


def _nearest(space: Space, z: np.ndarray, members: list[int]) -> np.ndarray:
    theta = space.theta(z)
    some = np.array([k for k in members if theta[k] > 0.0], dtype=np.int64)
    if not len(some):
        return z
    with np.errstate(divide="ignore"):
        low, high = (np.log(np.maximum(bound[some], 0.0) / theta[some]) for bound in (space.low, space.high))
    low, high = max(float(low.max()), -_FURTHEST), min(float(high.min()), _FURTHEST)
    for _ in range(_NARROWER):
        scaled = np.tile(theta, (_FACTORS, 1))
        scaled[:, some] *= np.exp(factors := np.linspace(low, high, _FACTORS))[:, None]
        found = np.tile(z, (_FACTORS, 1))
        found[:, some] = space.z(scaled)[:, some]
        best = int(distance(space, found).argmin())
        low, high = float(factors[max(best - 1, 0)]), float(factors[min(best + 1, _FACTORS - 1)])
    return np.clip(found[best], space.z_low, space.z_high)


def parameters_by_place(core: CoreArrays) -> dict[int, list[int]]:
    """Offset into the physical vector P -> the parameters that move it."""
    owner: dict[int, list[int]] = {}
    ptr, idx = core.par_ptr, core.par_idx
    for k in range(len(ptr) - 1):
        for place in idx[ptr[k] : ptr[k + 1]]:
            owner.setdefault(int(place), []).append(k)
    return owner


def _force_places(core: CoreArrays, members: list[int], owner: Mapping[int, list[int]]) -> list[int]:
    """Offsets into P of every force on ``members`` but gravity; those that the file has not are 0 there.

    An actuator scales by its gains together, or, where these are no parameters, by its gear. Of contacts, those of
    springs and dampers count, whose forces are told in N; the softness of others is relative to masses.
    """
    layout, bodies, inside = core.layout, _bodies_of_lines(core), set(members)
    lines = [k for k, of in enumerate(bodies) if not inside.isdisjoint(of)]
    places = [layout.dof(k, field) for k in lines for field in _FORCES]
    for a, line in enumerate(core.act_line):
        if line in lines and core.P[gear := layout.actuator(a)] != 0.0:
            places += [gear] if _by_gear(core, owner, a) else [layout.actuator(a, field) for field in _GAINS]
    for k, actuator in enumerate(core.wide_act):
        dofs = core.wide_dof[core.wide_ptr[k] : core.wide_ptr[k + 1]]
        if (bodies[dofs[0]][0] if len(dofs) else int(core.wide_body[k])) in inside:
            places.append(layout.actuator(int(actuator), "gear"))
    for k in np.flatnonzero(core.con_law == CONTACT_LAWS["spring-damper"]).tolist():
        if not inside.isdisjoint((int(core.con_bodyA[k]), int(core.con_bodyB[k]))):
            places += [int(layout.contacts(np.array([k]), field)[0]) for field in _SPRINGS]
    return places


def _by_gear(core: CoreArrays, owner: Mapping[int, list[int]], actuator: int) -> bool:
    """A servo's gear moves its target too, so that no force scales by it alone."""
    layout = core.layout
    return layout.actuator(actuator) in owner and layout.actuator(actuator, "gain") not in owner


def _limit_places(core: CoreArrays, members: list[int], owner: Mapping[int, list[int]]) -> list[int]:
    """Offsets into P of the limits of actuators on ``members`` that no gear scales."""
    layout, inside = core.layout, set(members)
    lines = [k for k, of in enumerate(_bodies_of_lines(core)) if not inside.isdisjoint(of)]
    driven = [a for a, line in enumerate(core.act_line) if line in lines and not _by_gear(core, owner, a)]
    return [layout.actuator(a, field) for a in driven for field in ("limit", "limit_slope")]


def _felt(core: CoreArrays, members: list[int]) -> list[int]:
    """Offsets into P of the density and the viscosity of the fluid, of what tells ``members``' masses by its drag."""
    mass = sum(float(core.P[core.layout.mass(b)]) for b in members)
    boxes, along = np.isin(core.box_body, members), slice(-core.layout.dimension, None)
    ellipsoids = core.ellipsoid_coef[np.isin(core.ellipsoid_body, members)]
    found = drags(core.box_linear[boxes, along], core.box_quadratic[boxes, along], ellipsoids)
    felt = zip(_fluid_places(core), found, strict=True)
    return [place for place, drag in felt if core.P[place] * drag > _FELT * mass]


def _fluid_places(core: CoreArrays) -> tuple[int, int]:
    return core.layout.fluid, core.layout.fluid + 1


def _bodies_of_lines(core: CoreArrays) -> list[list[int]]:
    """The bodies whose joints each degree of freedom, then each tendon, is made of."""
    of_dof = [-1] * core.nv
    for kind, body, dof in zip(core.jnt_type, core.jnt_body, core.jnt_vadr, strict=True):
        for k in range(dof, dof + (3 if kind == JointKind.BALL else 1)):
            of_dof[k] = int(body)
    ends = core.tendon_ptr
    tendons = [[of_dof[k] for k in core.tendon_dof[a:b]] for a, b in pairwise(ends)]
    return [[body] for body in of_dof] + tendons


def _sets(core: CoreArrays) -> list[list[int]]:
    """Lists of bodies that exchange impulses, through joints, contact, tendons or equality constraints."""
    root = list(range(core.nbody))

    def find(body: int) -> int:
        while root[body] != body:
            body = root[body]
        return body

    lines = _bodies_of_lines(core)
    links = [*enumerate(core.body_parent), *zip(core.con_bodyA, core.con_bodyB, strict=True)]
    links += [(bodies[0], body) for bodies in lines for body in bodies]
    for kind, a, b in zip(core.tie_type, core.tie_A, core.tie_B, strict=True):
        if kind == TieKind.POLYNOMIAL:
            a, b = lines[a][0], lines[b][0] if b != WORLD else WORLD
        links.append((a, b))
    for a, b in links:
        if a >= 0 and b >= 0:
            root[find(int(a))] = find(int(b))
    members: dict[int, list[int]] = {}
    for body in range(len(root)):
        members.setdefault(find(body), []).append(body)
    return list(members.values())
