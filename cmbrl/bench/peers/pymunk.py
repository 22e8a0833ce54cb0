"""Chipmunk 2D (through pymunk): planar worlds of free, sliding and turning bodies.

The space is built from the compiled MJCF. x and z become its plane; a body that cannot turn gets an infinite moment,
one that moves along a single axis a groove joint. Chipmunk multiplies friction and elasticity of two shapes, so each
shape gets the square root. Trees of bodies are left out: Chipmunk joins free bodies by iterated constraints and has
neither armature nor joint springs, so they would be other robots.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, sqrt
from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.bench.peers.simulator import Array, NotExpressibleError, Simulator, World
from cmbrl.errors import UserError

try:
    import pymunk
except ImportError:
    pymunk = None  # type: ignore[assignment]

X, Z, TURN = 0, 1, 2  # along the plane's axes, and about +y, from z to x; Chipmunk turns from x to z
_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
_FREEDOMS = {(_SLIDE, (1, 0, 0)): X, (_SLIDE, (0, 0, 1)): Z, (_HINGE, (0, 1, 0)): TURN}
_PUSH = {X: (1.0, 0.0), Z: (0.0, 1.0), TURN: (0.0, 0.0)}
_LONG = 1000.0  # half-length of what stands for an infinite line [m]


class Pymunk(Simulator):
    """``iterations`` of sequential impulses a step, Chipmunk's default 10; ``slop``: penetration left alone [m].

    Chipmunk's default slop of 0.1 length units is meant for pixels. Its step can be called from Python only, at about
    1 us a call.
    """

    def __init__(self, world: World, iterations: int = 10, slop: float = 0.0) -> None:
        if pymunk is None:
            raise UserError("pymunk is not installed: pip install 'cmbrl[tasks]'")
        self._model, self._iterations, self._slop = compiled(world.mjcf), iterations, slop
        model = self._model
        free = [freedoms(model, number) for number in range(model.nbody)]
        self._bodies = [_body(model, number, free[number]) for number in range(1, model.nbody)]
        self._shapes = [_shape(model, geom, sqrt(world.restitution)) for geom in range(model.ngeom)]
        self._axes = [_freedom(model, joint) for joint in range(model.njnt)]
        self._origins = [model.body_pos[body][[0, 2]] for body in model.jnt_bodyid]
        self._springs = [(int(j), float(model.jnt_stiffness[j])) for j in np.flatnonzero(model.jnt_stiffness)]

    def start(self, h: float, q: Array, v: Array) -> None:
        model, space = self._model, pymunk.Space()
        space.iterations, space.collision_slop = self._iterations, self._slop
        space.gravity = (float(model.opt.gravity[0]), float(model.opt.gravity[2]))
        carriers: list[Any] = [space.static_body]
        for mass, moment, place, groove in self._bodies:
            carrier = pymunk.Body(mass, moment)
            carrier.position = place
            space.add(carrier)
            if groove:
                space.add(pymunk.GrooveJoint(space.static_body, carrier, groove[0], groove[1], (0, 0)))
            carriers.append(carrier)
        for body, kind, arguments, attributes in self._shapes:
            shape = kind(carriers[body], *arguments)
            for name, value in attributes.items():
                setattr(shape, name, value)
            space.add(shape)
        self._space, self._h = space, h
        self._carriers = [carriers[body] for body in model.jnt_bodyid]
        for axis, carrier, x, speed in zip(self._axes, self._carriers, map(float, q), map(float, v), strict=True):
            if axis == TURN:
                carrier.angle, carrier.angular_velocity = -x, -speed
            else:
                carrier.position += (x * _PUSH[axis][0], x * _PUSH[axis][1])
                carrier.velocity += (speed * _PUSH[axis][0], speed * _PUSH[axis][1])
        space.reindex_shapes_for_body(space.static_body)

    def step(self, control: Sequence[float] | Array, count: int) -> None:
        motors = [(int(joint), float(x)) for joint, x in zip(self._model.actuator_trnid[:, 0], control, strict=True)]
        for _ in range(count):
            for joint, force in motors:
                self._push(joint, force)
            for joint, stiffness in self._springs:  # Chipmunk takes them explicitly
                self._push(joint, -stiffness * self._place(joint))
            self._space.step(self._h)

    def state(self) -> tuple[Array, Array]:
        speeds = [
            -carrier.angular_velocity if axis == TURN else carrier.velocity[axis]
            for axis, carrier in zip(self._axes, self._carriers, strict=True)
        ]
        return np.array([self._place(joint) for joint in range(len(speeds))]), np.array(speeds)

    def _place(self, joint: int) -> float:
        axis, carrier = self._axes[joint], self._carriers[joint]
        return float(-carrier.angle if axis == TURN else carrier.position[axis] - self._origins[joint][axis])

    def _push(self, joint: int, force: float) -> None:
        x, z = _PUSH[self._axes[joint]]
        self._carriers[joint].force += (force * x, force * z)


def freedoms(model: mujoco.MjModel, number: int) -> set[int]:
    """X, Z, TURN of a body's joints; raises NotExpressibleError for what cannot be said in the plane."""
    first = model.body_jntadr[number]
    found = {_freedom(model, joint) for joint in range(first, first + model.body_jntnum[number])}
    if number and (model.body_parentid[number] != 0 or not found):
        raise NotExpressibleError("bodies on bodies")
    if number and np.abs(model.body_ipos[number]).max() > 0 and TURN in found:
        raise NotExpressibleError("a centre of mass off the joint")
    if found == {TURN}:
        raise NotExpressibleError("a hinge on the world")
    return found


def _freedom(model: mujoco.MjModel, joint: int) -> int:
    key = int(model.jnt_type[joint]), tuple(round(x) for x in model.jnt_axis[joint])
    if key not in _FREEDOMS:
        raise NotExpressibleError("not planar")
    if model.jnt_limited[joint] or model.dof_damping[model.jnt_dofadr[joint]]:
        raise NotExpressibleError("limits and dampers of joints")
    return _FREEDOMS[key]


def _body(model: mujoco.MjModel, number: int, free: set[int]) -> tuple[float, float, tuple[float, float], Any]:
    """Mass, moment, place, and the ends of its groove if it moves along a single axis."""
    moment = float(model.body_inertia[number, 1]) if TURN in free else inf
    x, z = float(model.body_pos[number, 0]), float(model.body_pos[number, 2])
    groove = None
    if not {X, Z} <= free:
        dx, dz = (_LONG, 0.0) if X in free else (0.0, _LONG)
        groove = (x - dx, z - dz), (x + dx, z + dz)
    return float(model.body_mass[number]), moment, (x, z), groove


def _shape(model: mujoco.MjModel, geom: int, elasticity: float) -> tuple[int, Any, tuple[Any, ...], dict[str, Any]]:
    """The body, pymunk's class, its arguments after the body, and attributes."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    axes = turn.reshape(3, 3)[np.ix_([0, 2], [0, 2])]
    centre, size = model.geom_pos[geom][[0, 2]], model.geom_size[geom]
    kind: Any
    arguments: tuple[Any, ...]
    match int(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            kind, arguments = pymunk.Circle, (float(size[0]), tuple(centre))
        case mujoco.mjtGeom.mjGEOM_BOX:
            corners = [centre + axes @ (sx * size[0], sz * size[2]) for sx in (-1, 1) for sz in (-1, 1)]
            kind, arguments = pymunk.Poly, ([(float(x), float(z)) for x, z in corners],)
        case mujoco.mjtGeom.mjGEOM_PLANE:  # a thick line whose upper side is the plane
            ends = (centre - axes[:, 1] + s * _LONG * axes[:, 0] for s in (-1, 1))
            kind, arguments = pymunk.Segment, (*((float(x), float(z)) for x, z in ends), 1.0)
        case _:
            raise NotExpressibleError("a shape that is neither a plane, a sphere nor a box")
    types, affinities = model.geom_contype, model.geom_conaffinity
    touches = (types[geom] & affinities != 0) | (types & affinities[geom] != 0)  # (ngeom,)
    attributes = {
        "friction": sqrt(model.geom_friction[geom, 0]) if model.geom_condim[geom] > 1 else 0.0,
        "elasticity": elasticity,
        "filter": pymunk.ShapeFilter(categories=1 << geom, mask=sum(1 << int(k) for k in np.flatnonzero(touches))),
    }
    return int(model.geom_bodyid[geom]), kind, arguments, attributes
