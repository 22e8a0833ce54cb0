"""What can be fitted of joints and actuators."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from cmbrl.scene.fittable.collector import Collector
from cmbrl.scene.fittable.play import driven_by, plays
from cmbrl.scene.forces.actuators import UNLIMITED, Actuator, force_limit
from cmbrl.scene.layout import Layout
from cmbrl.scene.records import WORLD, Array, Joint, JointKind, Tree
from cmbrl.scene.source.mjcf import friction_acts, limits_act

_UNITS = {  # for slides, for hinges and balls
    "damping": ("N s/m", "N m s/rad"),
    "armature": ("kg", "kg m^2"),
    "stiffness": ("N/m", "N m/rad"),
    "frictionloss": ("N", "N m"),
}
# Bounds of what is 0 in the file, whichever is larger. Damping: the inertia at qpos0 times 5/s, or what holds the
# motors to 2 rad/s (or m/s). Armature: that inertia, or what holds the motors to 100 rad/s^2 (or m/s^2), since a rotor
# behind a gear may outweigh its link. Friction loss: what brakes the inertia by 30 rad/s^2, three times what holds all
# that hangs on the joint in any pose, or a quarter of the motors' strength.
INERTIAS = {"damping": 5.0, "armature": 1.0, "frictionloss": 30.0}
STRENGTHS = {"damping": 0.5, "armature": 0.01, "frictionloss": 0.25}
_WEIGHTS = 3.0
_TIMES = 20.0  # and its inverse, of what is not 0 in the file
_GAIN = 2.5  # reach of gains, to 56 times the file's and its inverse: a log's units, or a driver's, may be others
_REACH = 0.2  # [rad, m] off its target, where a servo without a limit is said to give all it has
_LEAST_LIMIT = {True: 0.01, False: 1e-9}  # of the file's limit of a force; of UNLIMITED, where it has none
_STEEPEST = 1e3  # [N m s/rad, N s/m] of a limit that falls with speed
STOPS = (("stop_time", 0.01, 100.0), ("stop_damping", 0.01, 100.0), ("stop_softness", 1e-3, 1e3))
GAP = {True: 0.02, False: 0.2}  # largest backlash of slides [m] and hinges [rad], and what a stop may be off


def offer_joints(
    model: mujoco.MjModel, tree: Tree, actuators: Sequence[Actuator], layout: Layout, P: Array, out: Collector
) -> None:
    """Joint parameters that are nonzero in the file; damping, armature and friction loss also where they are zero.

    Floating bases, which have none of these, are left out there; what thrusters push through air or water is dragged.
    Of a play, its gap: the rest is the driven joint's.
    """
    by_source: dict[int, list[Joint]] = {}
    free = plays(tree.joints)
    gaps = {joint.vadr for joint in free}
    for joint in tree.joints:
        if joint.vadr not in gaps:
            by_source.setdefault(joint.source, []).append(joint)
    bounds = _bounds(model, tree, actuators)
    for field in ("damping", "armature", "stiffness", "frictionloss"):
        for joints in by_source.values():
            dofs = [d for joint in joints for d in joint.dofs]
            indices = [layout.dof(d, field) for d in dofs]
            value, name = float(P[indices[0]]), joints[0].name
            unit = _UNITS[field][int(joints[-1].kind != JointKind.SLIDE)]
            high = float(bounds[field][dofs].max()) if field in bounds else 0.0
            if value > 0:
                token = high > _TIMES**2 * value  # then it bounds nothing, as where the file has none
                reach = np.log(high / value) / np.log(_TIMES) if token else 1.0
                out.add(field, name, value, value / _TIMES, value * _TIMES, unit, indices, reach=float(reach))
            elif high <= 0:
                continue
            elif field == "damping" and thrust(joints[0], actuators):
                _offer_drag(name, joints, bounds[field], layout, out)
            elif not floating(tree, joints[0], actuators):
                out.add(field, name, 0.0, 0.0, high, unit, indices)
    _offer_gaps(model, free, layout, out)
    _offer_stops(model, [joint for joints in by_source.values() for joint in joints], layout, out)
    every = [joint for joints in by_source.values() for joint in joints]
    own = [j for j in every if j.kind != JointKind.BALL and not floating(tree, j, actuators)]
    _offer_friction_laws(own, bounds["frictionloss"], layout, P, out)


def thrust(joint: Joint, actuators: Sequence[Actuator]) -> bool:
    """Whether an actuator pushes the body of a joint itself, as a propeller or a nozzle does, or along all its dofs."""
    reaches = [a.reach for a in actuators if a.reach and a.gear and a.reach.grips is None]
    return any(r.body == joint.body or not set(r.dofs).isdisjoint(joint.dofs) for r in reaches)


def _offer_drag(name: str, joints: Sequence[Joint], bounds: Array, layout: Layout, out: Collector) -> None:
    """What brakes the speed and the turning of a body that an actuator pushes, where its file has no damping.

    Rotors, ducts and hulls drag by far more than the boxes of MuJoCo's fluids do. A free joint of an MJCF has one
    number for both, whose units differ; a slide or a hinge has its own.
    """
    slides = [d for joint in joints if joint.kind == JointKind.SLIDE for d in joint.dofs]
    turns = [d for joint in joints if joint.kind != JointKind.SLIDE for d in joint.dofs]
    groups = ("drag", "turning_drag") if slides and turns else ("damping", "damping")
    for group, dofs, unit in zip(groups, (slides, turns), _UNITS["damping"], strict=True):
        if dofs and (high := float(bounds[dofs].max())) > 0:
            out.add(group, name, 0.0, 0.0, high, unit, [layout.dof(d, "damping") for d in dofs])


def _offer_stops(model: mujoco.MjModel, joints: Sequence[Joint], layout: Layout, out: Collector) -> None:
    """How hard the stops of joints are, of all together: they are built alike, and a log touches few of them.

    On request how much farther out those of one joint are.
    """
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    stopped = [j for j in joints if model.jnt_limited[j.source] and int(model.jnt_type[j.source]) != free]
    if not stopped or not limits_act(model):
        return
    for field, low, high in STOPS:
        out.add(field, "joints", 1.0, low, high, "1", [layout.dof(joint.dofs[-1], field) for joint in stopped])
    for joint in stopped:
        slides = joint.kind == JointKind.SLIDE
        most = min(GAP[slides], 0.45 * float(np.ptp(model.jnt_range[joint.source])))
        if most > 0 and joint.kind != JointKind.BALL:
            place, unit = [layout.dof(joint.vadr, "wider")], "m" if slides else "rad"
            out.add("stop", joint.name, 0.0, -most, most, unit, place, default=False)


def _offer_gaps(model: mujoco.MjModel, free: Sequence[Joint], layout: Layout, out: Collector) -> None:
    """Gaps, from end to end, of the joints that are plays."""
    for joint in free:
        gap, unit = float(np.ptp(model.jnt_range[joint.source])), "m" if joint.kind == JointKind.SLIDE else "rad"
        if model.jnt_limited[joint.source] and gap > 0.0:
            name, place = driven_by(joint.name), [layout.dof(joint.vadr, "wider")]
            out.add("play", name, gap, gap / _TIMES, gap * _TIMES, unit, place, 0.5)


def _offer_friction_laws(joints: Sequence[Joint], losses: Array, layout: Layout, P: Array, out: Collector) -> None:
    """Friction losses that change with the place and speed of ``joints``, on request: files have neither."""
    for joint in joints:
        if not losses[joint.vadr] > 0:
            continue
        most = max(float(losses[joint.vadr]), 20 * float(P[layout.dof(joint.vadr, "frictionloss")]))
        slides = joint.kind == JointKind.SLIDE
        slope, units = (10 * most, ("N/m", "N", "m/s")) if slides else (most, ("N m/rad", "N m", "rad/s"))
        speed = float(P[layout.dof(joint.vadr, "stribeck_speed")])
        offers = (
            ("friction_slope", 0.0, -slope, slope),
            ("stribeck", 0.0, 0.0, most),
            ("stribeck_speed", speed, speed / 20, speed * 20),
        )
        for (field, value, low, high), unit in zip(offers, units, strict=True):
            place = [layout.dof(joint.vadr, field)]
            out.add(field, joint.name, value, low, high, unit, place, default=False)


def _bounds(model: mujoco.MjModel, tree: Tree, actuators: Sequence[Actuator]) -> dict[str, Array]:
    """Largest values (nv,) by field of what is 0 in the file; no friction loss where the file switches it off."""
    inertia, strengths = np.asarray(model.dof_M0, dtype=float), _strengths(model, tree, actuators)
    found = {field: np.maximum(share * inertia, STRENGTHS[field] * strengths) for field, share in INERTIAS.items()}
    found["frictionloss"] = np.maximum(found["frictionloss"], _weights(model, tree)) * friction_acts(model)
    return found


def _weights(model: mujoco.MjModel, tree: Tree) -> Array:
    """Three times the force or torque (nv,) that holds all that hangs on a joint, in the worst pose."""
    found, g = np.zeros(model.nv), float(np.linalg.norm(model.opt.gravity))
    mass, moment = np.zeros(len(tree.bodies)), np.zeros((len(tree.bodies), 3))
    for k in reversed(range(len(tree.bodies))):
        body = tree.bodies[k]
        mass[k] += body.mass
        moment[k] += body.mass * tree.place(k, body.com)
        if body.parent != WORLD:
            mass[body.parent] += mass[k]
            moment[body.parent] += moment[k]
    for joint in tree.joints:
        k = joint.body
        arm = float(np.linalg.norm(moment[k] - mass[k] * tree.place(k, joint.pos)))
        weight = _WEIGHTS * g * (float(mass[k]) if joint.kind == JointKind.SLIDE else arm)
        found[list(joint.dofs)] = weight
    return found


def _strengths(model: mujoco.MjModel, tree: Tree, actuators: Sequence[Actuator]) -> Array:
    """The most force or torque (nv,) of the motors along each joint; 0 where it has none, or nothing limits them."""
    found = np.zeros(model.nv)
    for actuator in actuators:
        if 0 <= actuator.line < model.nv:
            found[actuator.line] += strength(actuator)
    for joint in tree.joints:
        if model.jnt_actfrclimited[joint.source]:
            most = float(np.abs(model.jnt_actfrcrange[joint.source]).max())
            found[list(joint.dofs)] = np.minimum(found[list(joint.dofs)], most)
    return np.where(np.isfinite(found), found, 0.0)


def strength(actuator: Actuator) -> float:
    """The most force that an actuator is allowed; of a servo without a limit, that of a usual error."""
    if not actuator.gear:
        return 0.0
    force = float(np.abs(actuator.force).max())
    if not np.isfinite(force) and actuator.bias[1]:
        force = abs(float(actuator.bias[1])) * _REACH
    elif not np.isfinite(force) and not np.any(actuator.bias):
        force = abs(actuator.gain) * (actuator.usual or float(np.abs(actuator.control).max()))
    return abs(actuator.gear) * force


def offer_actuator(tree: Tree, actuator: Actuator, layout: Layout, k: int, out: Collector) -> None:
    """Gains of a position servo; the gear of others, and of a servo behind a gear; the time constant of a filter.

    A velocity servo has its gain ``kv`` as well, which moves what the target and the speed are multiplied by together.
    A servo whose control is no target in rad or m, such as a gripper's from 0 to 255, has both: its stiffness ``kp``
    [N m/rad, N/m] moves all that it multiplies, so that it rests at the same place.
    Limits of the force and backlash on request, of actuators along a joint.
    """
    time = actuator.activation.time_constant if actuator.activation else 0.0
    if actuator.gear and time > 0:
        out.add("time_constant", actuator.name, time, time / 10, time * 10, "s", [layout.actuator(k, "time")])
    stiffness, damping = -float(actuator.bias[1]), -float(actuator.bias[2])
    servo = actuator.gear != 0 and stiffness > 0 and actuator.gain != 0
    if actuator.gear and not (servo and actuator.gear == 1 and actuator.gain == stiffness):
        out.add("gear", actuator.name, 1.0, 0.2, 5.0, "1", [layout.actuator(k)], actuator.gear, reach=_GAIN)
    joint = next((j for j in tree.joints if j.kind != JointKind.BALL and j.vadr == actuator.line), None)
    if actuator.gear and joint:
        _offer_limits(actuator, joint.kind == JointKind.SLIDE, layout, k, out)
    units = ("1", "1")  # of a tendon or a site, which may be a length or an angle
    if joint:
        units = ("N/m", "N s/m") if joint.kind == JointKind.SLIDE else ("N m/rad", "N m s/rad")
    if actuator.gear and not stiffness and damping > 0 and actuator.gain == damping:
        places = [layout.actuator(k, field) for field in ("gain", "bias2")]
        share = np.array([1.0, -1.0])
        out.add("kv", actuator.name, damping, damping / 5, damping * 5, units[1], places, share, reach=_GAIN)
    if not servo:
        return
    held = {"gain": actuator.gain / stiffness, "bias1": -1.0, "bias0": float(actuator.bias[0]) / stiffness}
    held = {field: each for field, each in held.items() if each}
    places, shares = [layout.actuator(k, field) for field in held], np.array(list(held.values()))
    out.add("kp", actuator.name, stiffness, stiffness / 5, stiffness * 5, units[0], places, shares, reach=_GAIN)
    if damping > 0:
        out.add("kd", actuator.name, damping, damping / 20, damping * 20, units[1], [layout.actuator(k, "bias2")], -1.0)


def _offer_limits(actuator: Actuator, slides: bool, layout: Layout, k: int, out: Collector) -> None:
    """A limit of the force below the file's, its fall with speed, and the gap of what pulls the position."""
    units = ("N", "N s/m", "m") if slides else ("N m", "N m s/rad", "rad")
    most, name, gap = force_limit(actuator), actuator.name, GAP[slides]
    if most > 0.0:
        least, place = most * _LEAST_LIMIT[most < UNLIMITED], [layout.actuator(k, "limit")]
        out.add("force_limit", name, most, least, most, units[0], place, default=False)
        place = [layout.actuator(k, "limit_slope")]
        out.add("force_limit_slope", name, 0.0, 0.0, min(most, _STEEPEST), units[1], place, default=False)
    if actuator.bias[1]:
        out.add("backlash", name, 0.0, 0.0, gap, units[2], [layout.actuator(k, "gap")], 0.5, default=False)


def floating(tree: Tree, joint: Joint, actuators: Sequence[Actuator]) -> bool:
    """Whether a joint places a body in space: a free joint, or one of several between a body and the world.

    Not where an actuator drives one of them: then they are the axes of a gantry, with friction of their own.
    """
    body = tree.bodies[joint.body]
    if body.parent != WORLD or len(body.joints) < 2:
        return False
    driven = {actuator.line for actuator in actuators}
    return driven.isdisjoint(dof for each in body.joints for dof in each.dofs)
