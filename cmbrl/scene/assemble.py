"""Builds the arrays of the C++ core from the records of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.actuators import Actuator, force_limit
from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.laws import CONTACT_LAWS, LawChoice
from cmbrl.scene.layout import CONTACT_FIELDS, Layout
from cmbrl.scene.mjcf import limits_act
from cmbrl.scene.records import WORLD, Array, Candidate, ContactLaw, JointKind, Segment, Tendon, Tie, TieKind, Tree
from cmbrl.scene.reduction import PlaneOfMotion
from cmbrl.scene.shapes import Shape

Arrays = dict[str, Any]

STRIBECK_SPEED = 0.1  # rad/s or m/s: dry friction that speed takes away, of which a file has none


def tree_arrays(tree: Tree, plane: PlaneOfMotion | None) -> Arrays:
    """Bodies and joints, in the plane of motion if there is one."""
    joints = tree.joints
    dimension = 2 if plane else 3
    pos: list[Array] = []
    rot: list[Array] = []
    axis: list[Array] = []
    anchor: list[Array] = []
    for k, body in enumerate(tree.bodies):
        if plane:
            turned = plane.rot[k] if body.parent == WORLD else plane.rot[body.parent].T @ plane.rot[k]
            origin = np.zeros(3) if body.parent == WORLD else tree.world_pos[body.parent]
            step = plane.basis @ (tree.world_pos[k] - origin)
            pos.append(step if body.parent == WORLD else plane.rot[body.parent].T @ step)
            rot.append(turned[:, 0])  # cosine, sine
        else:
            pos.append(body.pos)
            rot.append(body.rot.ravel())
    for joint in joints:
        anchor.append(plane.local(tree, joint.body, joint.pos) if plane else joint.pos)
        if plane and joint.kind == JointKind.HINGE:
            axis.append(np.array([np.sign(tree.turn(joint.body, joint.axis) @ plane.axis), 0.0]))
        else:
            axis.append(plane.local(tree, joint.body, joint.axis) if plane else joint.axis)
    counts = [len(body.joints) for body in tree.bodies]
    return {
        "body_parent": integers([body.parent for body in tree.bodies]),
        "body_pos": doubles(pos, (-1, dimension)),
        "body_rot": doubles(rot, (-1, 2 if plane else 9)),
        "body_jadr": integers(np.cumsum([0, *counts[:-1]])),
        "body_jnum": integers(counts),
        "jnt_type": integers([joint.kind for joint in joints]),
        "jnt_body": integers([joint.body for joint in joints]),
        "jnt_qadr": integers([joint.qadr for joint in joints]),
        "jnt_vadr": integers([joint.vadr for joint in joints]),
        "jnt_axis": doubles(axis, (-1, dimension)),
        "jnt_pos": doubles(anchor, (-1, dimension)),
        "jnt_q0": doubles([joint.q0 for joint in joints], (-1,)),
    }


def line_arrays(model: mujoco.MjModel, tree: Tree, tendons: list[Tendon], plane: PlaneOfMotion | None) -> Arrays:
    """Tendons, and dry friction and limits of joints and tendons."""
    source = [tendon.source for tendon in tendons]
    slack = np.diff(model.tendon_lengthspring[source]).reshape(-1)
    return {
        "tendon_ptr": integers(np.cumsum([0, *(len(tendon.dofs) for tendon in tendons)])),
        "tendon_dof": integers([dof for tendon in tendons for dof in tendon.dofs]),
        "tendon_coef": doubles([coef for tendon in tendons for coef in tendon.coefs], (-1,)),
        **_segment_arrays(tree, tendons, plane),
        "line_soft": _stack(
            np.hstack([model.dof_solref, model.dof_solimp]),
            np.hstack([model.tendon_solref_fri[source], model.tendon_solimp_fri[source]]),
        ),
        "line_invweight": _stack(model.dof_invweight0, model.tendon_invweight0[source]),
        "line_slack": _stack(np.zeros(model.nv), slack),
        **_limit_arrays(model, tree, tendons),
    }


def _segment_arrays(tree: Tree, tendons: list[Tendon], plane: PlaneOfMotion | None) -> Arrays:
    segments = [segment for tendon in tendons for segment in tendon.segments]
    dimension = 2 if plane else 3

    def points(ends: list[tuple[int, Array]]) -> Array:
        return doubles([plane.local(tree, *end) if plane else end[1] for end in ends], (-1, dimension))

    return {
        "seg_ptr": integers(np.cumsum([0, *(len(tendon.segments) for tendon in tendons)])),
        "seg_A": integers([s.body_a for s in segments]),
        "seg_B": integers([s.body_b for s in segments]),
        "seg_posA": points([(s.body_a, s.pos_a) for s in segments]),
        "seg_posB": points([(s.body_b, s.pos_b) for s in segments]),
        "seg_scale": doubles([s.scale for s in segments], (-1,)),
        **_obstacle_arrays(segments),
    }


def _obstacle_arrays(segments: list[Segment]) -> Arrays:
    """What segments go around, one for each that goes around something."""
    found, which = [s.around for s in segments if s.around], -np.ones(len(segments), dtype=int)
    which[[s.around is not None for s in segments]] = np.arange(len(found))
    sites = [o.site or (WORLD, np.zeros(3)) for o in found]
    return {
        "seg_wrap": integers(which),
        "wrap_body": integers([o.body for o in found]),
        "wrap_kind": integers([(o.cylinder, o.site is not None) for o in found]),
        "wrap_pos": doubles([o.pos for o in found], (-1, 3)),
        "wrap_rot": doubles([o.rot for o in found], (-1, 9)),
        "wrap_radius": doubles([o.radius for o in found], (-1,)),
        "wrap_site_body": integers([body for body, _ in sites]),
        "wrap_site": doubles([pos for _, pos in sites], (-1, 3)),
    }


def _stack(of_dofs: Array, of_tendons: Array) -> Array:
    return np.ascontiguousarray(np.concatenate([of_dofs, of_tendons]), dtype=np.float64)


def _limit_arrays(model: mujoco.MjModel, tree: Tree, tendons: list[Tendon]) -> Arrays:
    limited = [j for j in tree.joints if limits_act(model) and model.jnt_limited[j.source]]
    limited = [j for j in limited if model.jnt_type[j.source] != mujoco.mjtJoint.mjJNT_FREE]
    source, dofs = [joint.source for joint in limited], [joint.dofs[-1] for joint in limited]
    lines = {
        model.nv + k: tendon.source
        for k, tendon in enumerate(tendons)
        if limits_act(model) and model.tendon_limited[tendon.source]
    }
    which = list(lines.values())
    ranges = np.concatenate([model.jnt_range[source], model.tendon_range[which]])
    for k in [k for k, joint in enumerate(limited) if joint.kind == JointKind.BALL]:
        ranges[k] = np.array([-1, 1]) * model.jnt_range[source[k]].max()  # of the angle, about any axis
    of_joints = np.hstack([model.jnt_solref[source], model.jnt_solimp[source]])
    of_tendons = np.hstack([model.tendon_solref_lim[which], model.tendon_solimp_lim[which]])
    return {
        "lim_line": integers([*dofs, *lines]),
        "lim_ball": integers([j.qadr if j.kind == JointKind.BALL else -1 for j in limited] + [-1] * len(lines)),
        "lim_lo": doubles(ranges[:, 0], (-1,)),
        "lim_hi": doubles(ranges[:, 1], (-1,)),
        "lim_margin": _stack(model.jnt_margin[source], model.tendon_margin[which]),
        "lim_soft": _stack(of_joints, of_tendons),
        "lim_invweight": _stack(model.dof_invweight0[dofs], model.tendon_invweight0[which]),
    }


def tie_arrays(tree: Tree, ties: list[Tie], plane: PlaneOfMotion | None) -> Arrays:
    """Equality constraints, in the plane of motion if there is one."""
    dimension = 2 if plane else 3

    def point(body: int, pos: Array) -> Array:
        return plane.local(tree, body, pos) if plane else pos

    def frames(tie: Tie) -> tuple[Array, Array]:
        if not plane:
            return tie.rot_a.ravel(), tie.rot_b.ravel()
        apart = tree.turn(tie.a, tie.rot_a) @ tree.turn(tie.b, tie.rot_b).T  # a turn about the plane's normal
        rot_a, rot_b = (np.eye(2) if body == WORLD else plane.rot[body].T for body in (tie.a, tie.b))
        return (rot_a @ plane.basis @ apart @ plane.basis.T)[:, 0], rot_b[:, 0]  # cosine, sine

    bodies = [tie if tie.kind != TieKind.POLYNOMIAL else replace(tie, a=WORLD, b=WORLD) for tie in ties]
    rots = [frames(tie) for tie in bodies]
    return {
        "tie_type": integers([tie.kind for tie in ties]),
        "tie_A": integers([tie.a for tie in ties]),
        "tie_B": integers([tie.b for tie in ties]),
        "tie_posA": doubles([point(tie.a, tie.pos_a) for tie in bodies], (-1, dimension)),
        "tie_posB": doubles([point(tie.b, tie.pos_b) for tie in bodies], (-1, dimension)),
        "tie_rotA": doubles([rot for rot, _ in rots], (-1, 2 if plane else 9)),
        "tie_rotB": doubles([rot for _, rot in rots], (-1, 2 if plane else 9)),
        "tie_scale": doubles([tie.scale for tie in ties], (-1,)),
        "tie_poly": doubles([tie.poly for tie in ties], (-1, 5)),
        "tie_ref": doubles([tie.ref for tie in ties], (-1, 2)),
        "tie_soft": doubles([[*tie.solref, *tie.solimp] for tie in ties], (-1, 7)),
        "tie_invweight": doubles([tie.inverse_weight for tie in ties], (-1, 2)),
    }


def contact_arrays(
    model: mujoco.MjModel,
    candidates: list[Candidate],
    planes: list[Shape],
    plane: PlaneOfMotion | None,
    contact_law: str,
) -> Arrays:
    """Contact candidates, and the planes that they may touch."""
    dimension = 2 if plane else 3
    laws = [c.law for c in candidates]
    normals = np.array([ground.rot[:, 2] for ground in planes]).reshape(-1, 3)
    number = {ground.geom: k for k, ground in enumerate(planes)}
    pairs: dict[tuple[int, int], int] = {}
    pyramid = int(model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL)

    def vectors(field: str, size: int = dimension) -> Array:
        rows = [getattr(c, field) for c in candidates]
        return doubles(np.concatenate(rows) if rows else [], (-1, size))

    return {
        "con_type": integers([c.kind for c in candidates]),
        "con_bodyA": integers([c.body_a for c in candidates]),
        "con_bodyB": integers([c.body_b for c in candidates]),
        "con_plane": integers([number[c.geoms[1]] if c.kind.on_plane else -1 for c in candidates]),
        "con_pair": integers([pairs.setdefault(c.geoms, len(pairs)) for c in candidates]),
        "con_posA": vectors("pos_a"),
        "con_axisA": vectors("axis_a"),
        "con_posB": vectors("pos_b"),
        "con_axisB": vectors("axis_b"),
        "con_rotB": vectors("rot_b", dimension**2),
        "con_halfB": vectors("half_b"),
        "con_rotA": vectors("rot_a", dimension**2),
        "con_along": vectors("along", 3),
        "con_when": integers([c.when for c in candidates]),
        "con_radiusB": doubles([c.radius_b for c in candidates], (-1,)),
        "con_dim": integers([law.dim for law in laws]),
        "con_law": integers([CONTACT_LAWS[contact_law]] * len(laws)),
        "con_pyramid": integers([pyramid * law.edges for law in laws]),
        "con_impratio": doubles([float(model.opt.impratio)] * len(laws), (-1,)),
        "con_invweight": doubles([law.inverse_weight for law in laws], (-1,)),
        "con_margin": doubles([law.margin for law in laws], (-1,)),
        "con_mid": doubles([law.solimp[3] for law in laws], (-1,)),
        "con_power": doubles([law.solimp[4] for law in laws], (-1,)),
        "plane_normal": doubles(normals @ plane.basis.T if plane else normals, (-1, dimension)),
    }


def _spring_damper(law: ContactLaw) -> tuple[float, float]:
    """Stiffness [N/m] and damping [N s/m] that give the contact's effective mass the time constant of its solref."""
    (first, second), dmax, mass = law.solref, float(np.clip(law.solimp[1], 1e-4, 0.9999)), 1 / law.inverse_weight
    if first > 0:
        return mass / (dmax * first * second) ** 2, 2 * mass / (dmax * first)
    return -mass * first / dmax**2, -mass * second / dmax


def _law_block(own: ContactLaw, law: LawChoice) -> Array:
    """Block (9,) of a contact in P, without the sum of radii and the weight of the candidate."""
    ref: Sequence[float] | Array = own.solref
    if law.name == "spring-damper":
        ref = _spring_damper(own)
    elif law.name == "logistic":
        ref = law.stiffness, 0.0
    return np.array([own.friction, 0.0, 0.0, *ref, *own.solimp[:3], 0.0])  # MJCF cannot express restitution


def physical_vector(
    model: mujoco.MjModel,
    tree: Tree,
    candidates: list[Candidate],
    planes: list[Shape],
    tendons: list[Tendon],
    actuators: list[Actuator],
    plane: PlaneOfMotion | None,
    layout: Layout,
    law: LawChoice,
) -> Array:
    """P (nP,) at the values of the file, in the order of ``layout.py``."""
    off, flags = mujoco.mjtDisableBit, model.opt.disableflags
    P = np.zeros(layout.size)
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
    bent = np.any(getattr(model, "jnt_stiffnesspoly", np.zeros((model.njnt, 2))) != 0, axis=-1)
    for joint in tree.joints:
        stiffness = 0.0 if flags & off.mjDSBL_SPRING else model.jnt_stiffness[joint.source]
        reference = model.qpos_spring[joint.qadr] if joint.kind != JointKind.BALL else 0.0
        for dof in joint.dofs:
            P[layout.dof(dof, "armature")] = model.dof_armature[dof]
            P[layout.dof(dof, "damping")] = 0.0 if flags & off.mjDSBL_DAMPER else model.dof_damping[dof]
            P[layout.dof(dof, "stiffness")] = stiffness
            P[layout.dof(dof, "springref")] = reference if stiffness or bent[joint.source] else 0.0
            if not flags & (off.mjDSBL_FRICTIONLOSS | off.mjDSBL_CONSTRAINT):
                P[layout.dof(dof, "frictionloss")] = model.dof_frictionloss[dof]
            P[layout.dof(dof, "stribeck_speed")] = STRIBECK_SPEED
    armature = getattr(model, "tendon_armature", np.zeros(model.ntendon))  # of recent MuJoCo versions
    for k, tendon in enumerate(tendons):
        source, first = tendon.source, layout.dof(model.nv + k)
        stiffness = 0.0 if flags & off.mjDSBL_SPRING else model.tendon_stiffness[source]
        damping = 0.0 if flags & off.mjDSBL_DAMPER else model.tendon_damping[source]
        reference = model.tendon_lengthspring[source, 0] if stiffness else 0.0
        loss = 0.0 if flags & (off.mjDSBL_FRICTIONLOSS | off.mjDSBL_CONSTRAINT) else model.tendon_frictionloss[source]
        P[first : first + 5] = [armature[source], damping, stiffness, reference, loss]
    blocks = P[layout.contact(0) :].reshape(-1, len(CONTACT_FIELDS))
    laws = {id(c.law): c.law for c in candidates}  # pairs of the same surfaces share theirs
    shared = {key: _law_block(own, law) for key, own in laws.items()}
    for block, c in zip(blocks, candidates, strict=True):
        block[:] = shared[id(c.law)]
    blocks[:, 2] = [c.radius_a + c.radius_b for c in candidates]
    blocks[:, 8] = [1 / c.weight for c in candidates]
    for k, ground in enumerate(planes):
        P[layout.plane(k)] = ground.rot[:, 2] @ ground.pos
    for k, actuator in enumerate(actuators):
        first = layout.actuator(k)
        time = actuator.activation.time_constant if actuator.activation else 0.0
        P[first : first + 7] = [actuator.gear, actuator.gain, *actuator.bias, time, force_limit(actuator)]
        if actuator.reach is None:
            P[layout.dof(actuator.line, "armature")] += actuator.armature
            P[layout.dof(actuator.line, "damping")] += actuator.damping
    if not flags & off.mjDSBL_GRAVITY:
        gravity = np.asarray(model.opt.gravity)
        P[layout.gravity : layout.contact(0)] = plane.basis @ gravity if plane else gravity
    return P
