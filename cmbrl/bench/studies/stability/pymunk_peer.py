"""Chipmunk (through pymunk) as a simulator of the bank: planar worlds of free, sliding and turning bodies.

The space is built from the compiled MJCF: x and z become its plane, a body that cannot turn gets an infinite moment,
one that moves along one axis only a groove joint. Chipmunk multiplies the friction and elasticity of two shapes, so
each gets the square root. Its slop of 0.1 length units is meant for pixels; here it is 0.1 mm.
"""

from __future__ import annotations

from math import sqrt

import mujoco
import numpy as np

from cmbrl.bench.studies.stability.case import Case, NotExpressibleError
from cmbrl.bench.studies.stability.simulators import compiled, start_state
from cmbrl.errors import UserError

try:
    import pymunk
except ImportError:
    pymunk = None  # type: ignore[assignment]

ITERATIONS, SLOP = 50, 1e-4  # Chipmunk's defaults: 10 and 0.1
LONG = 1000.0  # half-length of what stands for an infinite line [m]
SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
LETTERS = {(SLIDE, (1, 0, 0)): "x", (SLIDE, (0, 0, 1)): "z", (HINGE, (0, 1, 0)): "r"}
PLANE, SPHERE, BOX = (
    int(g) for g in (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_BOX)
)


class Pymunk:
    """With 50 iterations, as many as the PGS column has sweeps."""

    name = "pymunk"

    def start(self, case: Case, h: float) -> PymunkUnderWay:
        if pymunk is None:
            raise UserError("pymunk is not installed: pip install 'cmbrl[tasks]'")
        return PymunkUnderWay(case, h)


class PymunkUnderWay:
    """One Chipmunk space; q, v are read back in the layout of the MJCF."""

    failures = 0

    def __init__(self, case: Case, h: float) -> None:
        model = compiled(case.mjcf)
        self._model, self._h, self._control = model, h, case.control
        self._space = pymunk.Space()
        self._space.iterations, self._space.collision_slop = ITERATIONS, SLOP
        self._space.gravity = (float(model.opt.gravity[0]), float(model.opt.gravity[2]))
        self._freedoms = [freedoms(model, k) for k in range(model.nbody)]
        self._bodies = [self._space.static_body] + [self._add_body(k) for k in range(1, model.nbody)]
        for k in range(model.ngeom):
            self._add_shape(k, sqrt(case.restitution))
        self._place(*start_state(case))

    def step(self, count: int) -> None:
        for _ in range(count):
            for joint, force in self._forces():
                letter, carrier = self._letter(joint), self._bodies[self._model.jnt_bodyid[joint]]
                carrier.force = (
                    carrier.force[0] + force * (letter == "x"), carrier.force[1] + force * (letter == "z")
                )  # fmt: skip
            self._space.step(self._h)

    @property
    def q(self) -> np.ndarray:
        out = np.empty(self._model.nq)
        for joint, carrier, origin in self._joints():
            at = carrier.position
            out[self._model.jnt_qposadr[joint]] = {
                "x": at[0] - origin[0], "z": at[1] - origin[2], "r": -carrier.angle
            }[self._letter(joint)]  # fmt: skip
        return out

    @property
    def v(self) -> np.ndarray:
        out = np.empty(self._model.nv)
        for joint, carrier, _ in self._joints():
            speed = carrier.velocity
            out[self._model.jnt_dofadr[joint]] = {"x": speed[0], "z": speed[1], "r": -carrier.angular_velocity}[
                self._letter(joint)
            ]
        return out

    def _place(self, q: np.ndarray, v: np.ndarray) -> None:
        for joint, carrier, _ in self._joints():
            x, speed = q[self._model.jnt_qposadr[joint]], v[self._model.jnt_dofadr[joint]]
            letter, at, old = self._letter(joint), carrier.position, carrier.velocity
            if letter == "r":
                carrier.angle, carrier.angular_velocity = -x, -speed
            elif letter == "x":
                carrier.position, carrier.velocity = (at[0] + x, at[1]), (speed, old[1])
            else:
                carrier.position, carrier.velocity = (at[0], at[1] + x), (old[0], speed)
        self._space.reindex_shapes_for_body(self._space.static_body)

    def _joints(self) -> list[tuple[int, pymunk.Body, np.ndarray]]:
        model = self._model
        return [(j, self._bodies[model.jnt_bodyid[j]], model.body_pos[model.jnt_bodyid[j]]) for j in range(model.njnt)]

    def _letter(self, joint: int) -> str:
        return letter_of(self._model, joint)

    def _forces(self) -> list[tuple[int, float]]:
        """Motors and joint springs, which Chipmunk takes explicitly."""
        model = self._model
        out = [(int(model.actuator_trnid[k, 0]), float(x)) for k, x in enumerate(self._control)]
        springs = np.flatnonzero(model.jnt_stiffness)
        q = self.q if len(springs) else np.empty(0)
        return out + [(int(j), float(-model.jnt_stiffness[j] * q[model.jnt_qposadr[j]])) for j in springs]

    def _add_body(self, number: int) -> pymunk.Body:
        model, free = self._model, self._freedoms[number]
        moment = float(model.body_inertia[number, 1]) if "r" in free else float("inf")
        carrier = pymunk.Body(float(model.body_mass[number]), moment)
        x, z = float(model.body_pos[number, 0]), float(model.body_pos[number, 2])
        carrier.position = (x, z)
        self._space.add(carrier)
        if free.isdisjoint("z") or free.isdisjoint("x"):
            along = (LONG, 0.0) if "x" in free else (0.0, LONG)
            ends = (x - along[0], z - along[1]), (x + along[0], z + along[1])
            self._space.add(pymunk.GrooveJoint(self._space.static_body, carrier, *ends, (0, 0)))
        return carrier

    def _add_shape(self, geom: int, elasticity: float) -> None:
        model = self._model
        carrier, kind = self._bodies[model.geom_bodyid[geom]], int(model.geom_type[geom])
        place, turn = model.geom_pos[geom], np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        axes = turn.reshape(3, 3)[np.ix_([0, 2], [0, 2])]
        centre, size = np.array([place[0], place[2]]), model.geom_size[geom]
        shape: pymunk.Shape
        if kind == SPHERE:
            shape = pymunk.Circle(carrier, float(size[0]), tuple(centre))
        elif kind == BOX:
            corners = [centre + axes @ (sx * size[0], sz * size[2]) for sx in (-1, 1) for sz in (-1, 1)]
            shape = pymunk.Poly(carrier, [(float(x), float(z)) for x, z in corners])
        elif kind == PLANE:
            normal, along = axes[:, 1], axes[:, 0]
            a, b = (centre - normal + s * LONG * along for s in (-1, 1))  # a thick line whose upper side is the plane
            shape = pymunk.Segment(carrier, (float(a[0]), float(a[1])), (float(b[0]), float(b[1])), 1.0)
        else:
            raise NotExpressibleError("a shape that is neither a plane, a sphere nor a box")
        rubs = model.geom_condim[geom] > 1
        shape.friction, shape.elasticity = sqrt(model.geom_friction[geom, 0]) if rubs else 0.0, elasticity
        shape.filter = pymunk.ShapeFilter(categories=1 << geom, mask=sum(1 << k for k in partners(model, geom)))
        self._space.add(shape)


def freedoms(model: mujoco.MjModel, number: int) -> set[str]:
    """Letters x, z, r of a body's joints; raises NotExpressibleError where the plane has no words for it."""
    first = model.body_jntadr[number]
    joints = range(first, first + model.body_jntnum[number])
    letters = {letter_of(model, j) for j in joints}
    if number and (model.body_parentid[number] != 0 or not joints):
        raise NotExpressibleError("bodies on bodies")
    if number and np.abs(model.body_ipos[number]).max() > 0 and "r" in letters:
        raise NotExpressibleError("a centre of mass off the joint")
    if letters == {"r"}:
        raise NotExpressibleError("a hinge on the world")
    return letters


def letter_of(model: mujoco.MjModel, joint: int) -> str:
    """x, z or r of a joint."""
    key = int(model.jnt_type[joint]), tuple(round(x) for x in model.jnt_axis[joint])
    if key not in LETTERS:
        raise NotExpressibleError("not planar")
    if model.jnt_limited[joint] or model.dof_damping[model.jnt_dofadr[joint]]:
        raise NotExpressibleError("limits and dampers of joints")
    return LETTERS[key]


def partners(model: mujoco.MjModel, geom: int) -> list[int]:
    """Geoms that MuJoCo's contype and conaffinity let this one touch."""
    kind, affinity = model.geom_contype, model.geom_conaffinity
    return [
        k for k in range(model.ngeom) if (kind[geom] & affinity[k]) or (kind[k] & affinity[geom])
    ]  # fmt: skip
