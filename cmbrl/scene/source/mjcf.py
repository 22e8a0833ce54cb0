"""Fuses the bodies of a compiled MuJoCo model into a tree of moving bodies."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import WORLD, Array, Body, Frame, Joint, JointKind, Tree

_ENOUGH = 20  # iterations of Newton's method, or of a line search, that solve contacts
_OBJECTS = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
    "equality": mujoco.mjtObj.mjOBJ_EQUALITY,
    "flex": mujoco.mjtObj.mjOBJ_FLEX,
    "hfield": mujoco.mjtObj.mjOBJ_HFIELD,
    "pair": mujoco.mjtObj.mjOBJ_PAIR,
}


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Name of an element of the file. Unnamed ones are ``<kind><number>``; an actuator takes its joint's name."""
    name = mujoco.mj_id2name(model, _OBJECTS[kind], number)
    if name:
        return name
    if kind == "actuator" and int(model.actuator_trntype[number]) in (
        mujoco.mjtTrn.mjTRN_JOINT,
        mujoco.mjtTrn.mjTRN_JOINTINPARENT,
    ):
        return name_of(model, "joint", int(model.actuator_trnid[number, 0]))
    if kind == "geom":
        body = int(model.geom_bodyid[number])
        return f"{name_of(model, 'body', body)}_geom{number - model.body_geomadr[body]}"
    return f"{kind}{number}"


def controlled(model: mujoco.MjModel) -> NDArray[np.int64]:
    """The actuator of each control (nu,); in recent versions of MuJoCo one may have several, or none."""
    count = len(model.actuator_trntype)
    return np.repeat(np.arange(count), getattr(model, "actuator_ctrlnum", np.ones(count, dtype=int)))


def control_names(model: mujoco.MjModel) -> list[str]:
    """Names (nu,) of the controls: that of the actuator, with a number where it has several, or is not the first."""
    owners, names = controlled(model).tolist(), list[str]()
    for at, k in enumerate(owners):
        number = f"_{at - owners.index(k)}" * (owners.count(k) > 1)
        name = choice = name_of(model, "actuator", k) + number
        count = 1
        while choice in names:
            count += 1
            choice = f"{name}_{count}"
        names.append(choice)
    return names


def act_addresses(model: mujoco.MjModel, controls: NDArray[np.int32]) -> NDArray[np.int32]:
    """Where the activations of the actuators of these controls stand in MuJoCo's ``act``."""
    return np.asarray(model.actuator_actadr[controlled(model)[controls]])


def read_tree(model: mujoco.MjModel) -> Tree:
    """The moving bodies, with inertia and joints. A free joint becomes three slides along the world axes and a ball."""
    bodies: list[Body] = []
    frames: list[Frame] = []
    for number in range(model.nbody):
        pos, rot = model.body_pos[number].copy(), quaternion_matrix(model.body_quat[number])
        if number == 0:
            frames.append(Frame(WORLD, np.zeros(3), np.eye(3)))
            continue
        carrier = frames[model.body_parentid[number]]
        pos, rot = carrier.pos + carrier.rot @ pos, carrier.rot @ rot
        if model.body_jntnum[number] == 0:
            frames.append(Frame(carrier.body, pos, rot))
            continue
        index = len(bodies)
        first = int(model.body_jntadr[number])
        free = model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE
        if free:  # its coordinates are world coordinates
            pos, rot = np.zeros(3), np.eye(3)
        body = Body(name_of(model, "body", number), carrier.body, pos, rot)
        for joint in range(first, first + int(model.body_jntnum[number])):
            body.joints += _read_joint(model, joint, index)
        bodies.append(body)
        frames.append(Frame(index, np.zeros(3), np.eye(3)))
    for number, frame in enumerate(frames):
        if frame.body != WORLD:
            com = frame.pos + frame.rot @ model.body_ipos[number]
            axes = frame.rot @ quaternion_matrix(model.body_iquat[number])
            bodies[frame.body].add_mass(
                float(model.body_mass[number]), com, axes @ np.diag(model.body_inertia[number]) @ axes.T
            )
    return Tree(bodies, frames, *_nominal_poses(model, bodies))


def read_places(model: mujoco.MjModel, tree: Tree) -> dict[str, Frame]:
    """Poses of the file's bodies and sites on the moving bodies that carry them, by name; a body's where both have it.

    Those of the world are not among them.
    """
    found = {}
    for number in range(model.nsite):
        carrier = tree.frames[model.site_bodyid[number]]
        pos, rot = model.site_pos[number], quaternion_matrix(model.site_quat[number])
        placed = Frame(carrier.body, carrier.pos + carrier.rot @ pos, carrier.rot @ rot)
        found[name_of(model, "site", number)] = placed
    found |= {name_of(model, "body", number): frame for number, frame in enumerate(tree.frames)}
    return {name: frame for name, frame in found.items() if frame.body != WORLD}


def _read_joint(model: mujoco.MjModel, number: int, body: int) -> list[Joint]:
    name = name_of(model, "joint", number)
    kind, qadr, vadr = int(model.jnt_type[number]), int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
    zero = np.zeros(3)
    if kind == mujoco.mjtJoint.mjJNT_FREE:
        slides = [
            Joint(name, JointKind.SLIDE, body, qadr + k, vadr + k, np.eye(3)[k], zero, 0.0, number) for k in range(3)
        ]
        return [*slides, Joint(name, JointKind.BALL, body, qadr + 3, vadr + 3, zero, zero, 0.0, number)]
    pos = model.jnt_pos[number].copy()
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        return [Joint(name, JointKind.BALL, body, qadr, vadr, zero, pos, 0.0, number)]
    kind = JointKind.SLIDE if kind == mujoco.mjtJoint.mjJNT_SLIDE else JointKind.HINGE
    return [Joint(name, kind, body, qadr, vadr, model.jnt_axis[number].copy(), pos, float(model.qpos0[qadr]), number)]


def _nominal_poses(model: mujoco.MjModel, bodies: list[Body]) -> tuple[Array, Array]:
    """World positions (nb, 3) and rotations (nb, 3, 3) of the moving bodies at qpos0."""
    pos, rot = np.zeros((len(bodies), 3)), np.zeros((len(bodies), 3, 3))
    for index, body in enumerate(bodies):
        origin, axes = (pos[body.parent], rot[body.parent]) if body.parent != WORLD else (np.zeros(3), np.eye(3))
        pos[index], rot[index] = origin + axes @ body.pos, axes @ body.rot
        first = body.joints[0]
        if len(body.joints) == 4 and body.joints[3].kind == JointKind.BALL and first.source == body.joints[3].source:
            pos[index] = model.qpos0[first.qadr : first.qadr + 3]
            rot[index] = quaternion_matrix(model.qpos0[first.qadr + 3 : first.qadr + 7])
    return pos, rot


def ignores(model: mujoco.MjModel, what: str) -> bool:
    """Whether the file's flags disable something: one of the names of mjtDisableBit, without its prefix."""
    return bool(model.opt.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{what}"))


def limits_act(model: mujoco.MjModel) -> bool:
    """Whether the file lets limits of joints and tendons act."""
    return not (ignores(model, "LIMIT") or ignores(model, "CONSTRAINT"))


def passive_forces_act(model: mujoco.MjModel) -> bool:
    """Whether there are passive forces at all: MuJoCo drops gravity compensation and drag with springs and dampers."""
    return not (ignores(model, "SPRING") and ignores(model, "DAMPER"))


def friction_acts(model: mujoco.MjModel) -> bool:
    """Whether the file lets joints and tendons lose force to dry friction."""
    return not (ignores(model, "FRICTIONLOSS") or ignores(model, "CONSTRAINT"))


def early(option: mujoco.MjOption) -> str:
    """In words, that MuJoCo may stop before contacts are solved, as in files made for MJX; "" where it does not."""
    newton = option.solver == mujoco.mjtSolver.mjSOL_NEWTON
    if newton and min(option.iterations, option.ls_iterations) >= _ENOUGH:
        return ""
    name = "Newton" if newton else mujoco.mjtSolver(option.solver).name.removeprefix("mjSOL_")
    search = f" ({option.ls_iterations} of their line searches)" if option.ls_iterations < _ENOUGH else ""
    return f"MuJoCo's solver ({name}) stops after {iterations(option.iterations)}{search}, solved or not"


def iterations(count: int) -> str:
    """So many iterations, in words."""
    return f"{count} iteration{'s' * (count != 1)}"
