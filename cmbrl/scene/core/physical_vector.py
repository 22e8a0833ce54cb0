"""The physical vector P of a scene at the values of its file; ``layout.py`` gives the order of its numbers."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.collision.contact_records import ContactLaw
from cmbrl.scene.collision.mixing import LEAST_FRICTION
from cmbrl.scene.forces.actuators import Actuator, force_limit
from cmbrl.scene.laws import LawChoice
from cmbrl.scene.layout import CONTACT_FIELDS, Layout
from cmbrl.scene.parts import Parts
from cmbrl.scene.records import Array, JointKind, Tendon, Tree
from cmbrl.scene.reduction import PlaneOfMotion
from cmbrl.scene.source.mjcf import friction_acts, ignores

STRIBECK_SPEED = 0.1  # rad/s or m/s: dry friction that speed takes away, of which a file has none


def physical_vector(model: mujoco.MjModel, parts: Parts, layout: Layout, law: LawChoice) -> Array:
    """P (nP,) at the values of the file, in the order of ``layout.py``."""
    P = np.zeros(layout.size)
    for line in range(layout.nv + layout.ntendon):
        P[layout.dof(line, "stop_time") : layout.dof(line, "stop_softness") + 1] = 1.0  # factors of the file's limits
    _write_bodies(P, layout, parts.tree, parts.plane)
    _write_joints(P, layout, model, parts.tree)
    _write_tendons(P, layout, model, parts.tendons)
    _write_contacts(P, layout, parts.candidates, law)
    for k, ground in enumerate(parts.grounds):
        P[layout.plane(k)] = ground.rot[:, 2] @ ground.pos
    _write_actuators(P, layout, parts.actuators)
    if parts.boxes or parts.ellipsoids:
        P[layout.fluid : layout.gravity] = model.opt.density, model.opt.viscosity
    if not ignores(model, "GRAVITY"):
        gravity = np.asarray(model.opt.gravity)
        P[layout.gravity : layout.contact(0)] = parts.plane.basis @ gravity if parts.plane else gravity
    return P


def _write_bodies(P: Array, layout: Layout, tree: Tree, plane: PlaneOfMotion | None) -> None:
    for k, body in enumerate(tree.bodies):
        P[layout.mass(k)] = body.mass
        com, inertia = layout.com(k), layout.inertia(k)
        P[com : com + layout.dimension] = plane.local(tree, k, body.com) if plane else body.com
        I = body.inertia  # noqa: E741
        if plane:
            axis = tree.world_rot[k].T @ plane.axis
            P[inertia] = axis @ I @ axis
        else:
            P[inertia : inertia + 6] = I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]


def _write_joints(P: Array, layout: Layout, model: mujoco.MjModel, tree: Tree) -> None:
    bent = np.any(getattr(model, "jnt_stiffnesspoly", np.zeros((model.njnt, 2))) != 0, axis=-1)
    for joint in tree.joints:
        stiffness = 0.0 if ignores(model, "SPRING") else model.jnt_stiffness[joint.source]
        reference = model.qpos_spring[joint.qadr] if joint.kind != JointKind.BALL else 0.0
        for dof in joint.dofs:
            P[layout.dof(dof, "armature")] = model.dof_armature[dof]
            P[layout.dof(dof, "damping")] = 0.0 if ignores(model, "DAMPER") else model.dof_damping[dof]
            P[layout.dof(dof, "stiffness")] = stiffness
            P[layout.dof(dof, "springref")] = reference if stiffness or bent[joint.source] else 0.0
            if friction_acts(model):
                P[layout.dof(dof, "frictionloss")] = model.dof_frictionloss[dof]
            P[layout.dof(dof, "stribeck_speed")] = STRIBECK_SPEED


def _write_tendons(P: Array, layout: Layout, model: mujoco.MjModel, tendons: list[Tendon]) -> None:
    armature = getattr(model, "tendon_armature", np.zeros(model.ntendon))  # of recent MuJoCo versions
    for k, tendon in enumerate(tendons):
        source, first = tendon.source, layout.dof(model.nv + k)
        stiffness = 0.0 if ignores(model, "SPRING") else model.tendon_stiffness[source]
        damping = 0.0 if ignores(model, "DAMPER") else model.tendon_damping[source]
        reference = model.tendon_lengthspring[source, 0] if stiffness else 0.0
        loss = model.tendon_frictionloss[source] if friction_acts(model) else 0.0
        own = 0.0 if tendon.segments else armature[source]
        P[first : first + 5] = [own, damping, stiffness, reference, loss]


def _write_actuators(P: Array, layout: Layout, actuators: list[Actuator]) -> None:
    """They add to the armature and damping of what they drive."""
    for k, actuator in enumerate(actuators):
        first = layout.actuator(k)
        time = actuator.activation.time_constant if actuator.activation else 0.0
        P[first : first + 7] = [actuator.gear, actuator.gain, *actuator.bias, time, force_limit(actuator)]
        for line in actuator.loads:
            P[layout.dof(line, "armature")] += actuator.armature
            P[layout.dof(line, "damping")] += actuator.damping


def _write_contacts(P: Array, layout: Layout, candidates: CandidateTable, law: LawChoice) -> None:
    blocks = P[layout.contact(0) :].reshape(-1, len(CONTACT_FIELDS))
    shared = np.array([_law_block(own, law) for own in candidates.laws]).reshape(-1, len(CONTACT_FIELDS))
    blocks[:] = shared[candidates.law]
    blocks[:, 2] = candidates.radii.sum(axis=1)
    blocks[:, 8] = 1 / candidates.weight


def _law_block(own: ContactLaw, law: LawChoice) -> Array:
    """Block (11,) of a contact in P, without the sum of radii and the weight of the candidate."""
    ref: Sequence[float] | Array = own.solref
    if law.name == "spring-damper":
        ref = _spring_damper(own)
    elif law.name == "logistic":
        ref = law.stiffness, 0.0
    friction, restitution = _sliding(own, law), 0.0  # which MJCF cannot express
    return np.array([friction, restitution, 0.0, *ref, *own.solimp[:3], 0.0, own.spin, own.roll])


def _sliding(own: ContactLaw, law: LawChoice) -> float:
    """The coefficient of sliding friction.

    MuJoCo raises one of 0, by which its law makes a contact stiffer, and without which nothing turns against friction.
    Elsewhere 0 stays: such a contact has fewer rows.
    """
    raised = own.dim > 3 or (own.dim > 1 and law.name == "mujoco")
    return max(own.friction, LEAST_FRICTION) if raised else own.friction


def _spring_damper(law: ContactLaw) -> tuple[float, float]:
    """Stiffness [N/m] and damping [N s/m] that give the contact's effective mass the time constant of its solref."""
    (first, second), dmax, mass = law.solref, float(np.clip(law.solimp[1], 1e-4, 0.9999)), 1 / law.inverse_weight
    if first > 0:
        return mass / (dmax * first * second) ** 2, 2 * mass / (dmax * first)
    return -mass * first / dmax**2, -mass * second / dmax
