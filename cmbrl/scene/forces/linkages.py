"""What actuators act along that is neither a coordinate nor a tendon: sites, slider-cranks, ball and free joints.

Each is a line of its own, with a length and a rate (MuJoCo's documentation, "Computation > Actuation model").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.forces.activation import dynamics_of
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import WORLD, Array, Tree


class LinkageKind(IntEnum):
    """What moves along the line."""

    BETWEEN_SITES = 0  #: a wrench in the axes of B's site; the length is the pose of A's site there, times the wrench
    ON_SITE = 1  #: a wrench in the axes of A's site, without a length
    SLIDER_CRANK = 2  #: the slider of B's site, along its z axis, which a rod joins to A's site
    BALL = 3  #: a ball joint's rotation vector, along an axis
    CONSTANT = 4  #: velocities of some coordinates, without a length


@dataclass(frozen=True)
class Linkage:
    """``a`` is a body; of a ball joint the place of its quaternion in q. ``b`` is a body or WORLD."""

    name: str
    source: int  # the number of its actuator in the file
    kind: LinkageKind
    dofs: tuple[int, ...]  # that move it, rising
    a: int
    b: int = WORLD
    turns: bool = False  # its wrench has a torque; of a ball joint: the axis is its parent's
    pos_a: Array = field(default_factory=lambda: np.zeros(3))  # (3,) of the sites, in the frames of the bodies
    pos_b: Array = field(default_factory=lambda: np.zeros(3))
    rot_a: Array = field(default_factory=lambda: np.eye(3))  # (3, 3)
    rot_b: Array = field(default_factory=lambda: np.eye(3))
    force: Array = field(default_factory=lambda: np.zeros(3))  # the wrench of a unit force; of a slider-crank, its axis
    torque: Array = field(default_factory=lambda: np.zeros(3))
    rod: float = 0.0  # [m]
    coefs: tuple[float, ...] = ()  # of a constant one, by dof
    measured: bool = True  # it has a length

    @property
    def size(self) -> float:
        """That of the wrench, which the actuator's gear multiplies."""
        return float(np.linalg.norm([*self.force, *self.torque, *self.coefs]))


def read_linkage(model: mujoco.MjModel, tree: Tree, k: int, name: str, gains: bool) -> Linkage | None:
    """That of actuator ``k``; None if it acts in another way.

    ``gains``: the force changes with length or velocity. Without them, forces on one site or joint need no line.
    """
    kind, (first, second) = model.actuator_trntype[k], model.actuator_trnid[k]
    gear, trn = model.actuator_gear[k], mujoco.mjtTrn
    if kind == trn.mjTRN_SLIDERCRANK:
        # the crank's site comes first
        axis = np.array([0.0, 0.0, 1.0])
        return _between(model, tree, name, LinkageKind.SLIDER_CRANK, int(first), int(second), axis, k)
    if kind == trn.mjTRN_SITE:
        between = second >= 0
        if not (between or gains):
            return None
        which = LinkageKind.BETWEEN_SITES if between else LinkageKind.ON_SITE
        return _between(model, tree, name, which, int(first), int(second), gear[:3], k, gear[3:])
    in_parent = kind == trn.mjTRN_JOINTINPARENT
    if kind != trn.mjTRN_JOINT and not in_parent:
        return None
    joint, dof = int(first), int(model.jnt_dofadr[first])
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL and (in_parent or gains):
        dofs, place = (dof, dof + 1, dof + 2), int(model.jnt_qposadr[joint])
        return Linkage(name, k, LinkageKind.BALL, dofs, place, turns=in_parent, torque=gear[:3].copy())
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE and (in_parent or gains):
        return _on_free_joint(model, tree, name, k, in_parent)
    return None


def _on_free_joint(model: mujoco.MjModel, tree: Tree, name: str, k: int, in_parent: bool) -> Linkage:
    """A force in the world's axes, and a torque in those of the world (in_parent) or of the body."""
    joint, gear = int(model.actuator_trnid[k, 0]), model.actuator_gear[k]
    frame, dof = tree.frames[model.jnt_bodyid[joint]], int(model.jnt_dofadr[joint])
    dofs = tuple(range(dof, dof + 6))
    if in_parent:
        wrench = gear[:3].copy(), gear[3:].copy()
        return Linkage(
            name, k, LinkageKind.BETWEEN_SITES, dofs, frame.body, force=wrench[0], torque=wrench[1], measured=False
        )
    return Linkage(name, k, LinkageKind.CONSTANT, dofs, frame.body, coefs=tuple(gear.tolist()), measured=False)


def _between(
    model: mujoco.MjModel,
    tree: Tree,
    name: str,
    kind: LinkageKind,
    first: int,
    second: int,
    force: Array,
    k: int,
    torque: Array | None = None,
) -> Linkage:
    a, b = _site(model, tree, first), _site(model, tree, second) if second >= 0 else (WORLD, np.zeros(3), np.eye(3))
    chains = [set(tree.chain(body)) for body in (a[0], b[0])]
    moving = sorted(chains[0] ^ chains[1])
    dofs = sorted(dof for body in moving for joint in tree.bodies[body].joints for dof in joint.dofs)
    torque = np.zeros(3) if torque is None else torque.copy()
    rod = float(model.actuator_cranklength[k]) if kind == LinkageKind.SLIDER_CRANK else 0.0
    return Linkage(
        name,
        k,
        kind,
        tuple(dofs),
        a[0],
        b[0],
        bool(np.any(torque)),
        a[1],
        b[1],
        a[2],
        b[2],
        force.copy(),
        torque,
        rod,
        measured=kind != LinkageKind.ON_SITE,
    )


def _site(model: mujoco.MjModel, tree: Tree, site: int) -> tuple[int, Array, Array]:
    """The body of a site, its place there, and its axes."""
    frame = tree.frames[model.site_bodyid[site]]
    rot = frame.rot @ quaternion_matrix(model.site_quat[site])
    return frame.body, frame.pos + frame.rot @ model.site_pos[site], rot


def wrap_period(model: mujoco.MjModel, k: int, linkage: Linkage | None) -> float:
    """By which MuJoCo wraps the target of a position servo on a rotation; 0 for others."""
    rotates = linkage is not None and (
        linkage.kind == LinkageKind.BALL
        or (linkage.kind == LinkageKind.BETWEEN_SITES and linkage.measured and not np.any(linkage.force))
    )
    pid = mujoco.mjtGain(int(model.actuator_gaintype[k])).name == "mjGAIN_PID"
    servo = pid or (
        model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
        and model.actuator_gainprm[k, 0] == -model.actuator_biasprm[k, 1]
        and dynamics_of(model, k) in ("none", "integrator")
    )
    return 2 * np.pi * linkage.size if linkage and rotates and servo and _targets_wrap() else 0.0


@lru_cache(maxsize=1)
def _targets_wrap() -> bool:
    """Whether this MuJoCo wraps targets of rotations (recent versions do); found by trying."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='j' type='ball'/><geom size='1'/></body></worldbody>"
        "<actuator><position joint='j' gear='1 0 0' kp='1'/></actuator></mujoco>"
    )
    data = mujoco.MjData(model)
    data.ctrl[0] = 2 * np.pi
    mujoco.mj_forward(model, data)
    return bool(abs(data.actuator_force[0]) < 1.0)


def inverse_weights(model: mujoco.MjModel, linkages: Sequence[Linkage]) -> Array:
    """How fast a unit force along each moves it at qpos0, per second: what tells how strong its damping is."""
    found = np.zeros(len(linkages))
    if not linkages:
        return found
    data, row = mujoco.MjData(model), np.zeros(model.nv)
    mujoco.mj_forward(model, data)
    for n, linkage in enumerate(linkages):
        moment = _moment(model, data, linkage.source)
        mujoco.mj_solveM(model, data, row.reshape(1, -1), moment.reshape(1, -1))
        gear = model.actuator_gear[linkage.source, 0] if linkage.kind == LinkageKind.SLIDER_CRANK else 1.0
        found[n] = moment @ row / gear**2 if gear else 0.0
    return found


def _moment(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> Array:
    """Moment arms (nv,) of an actuator, which recent versions of MuJoCo hold without their zeros."""
    held = np.asarray(data.actuator_moment)
    if held.ndim == 2:
        return np.array(held[row])
    first, count = int(data.moment_rowadr[row]), int(data.moment_rownnz[row])
    arms = np.zeros(model.nv)
    arms[data.moment_colind[first : first + count]] = held[first : first + count]
    return arms


def linkage_arrays(linkages: Sequence[Linkage], first: int) -> dict[str, Any]:
    """For the core; ``first`` is the line of the first one."""
    return {
        "nlink": len(linkages),
        "link_line": integers(range(first, first + len(linkages))),
        "link_kind": integers([x.kind for x in linkages]),
        "link_A": integers([x.a for x in linkages]),
        "link_B": integers([x.b for x in linkages]),
        "link_turns": integers([x.turns for x in linkages]),
        "link_posA": doubles([x.pos_a for x in linkages], (-1, 3)),
        "link_posB": doubles([x.pos_b for x in linkages], (-1, 3)),
        "link_rotA": doubles([x.rot_a for x in linkages], (-1, 9)),
        "link_rotB": doubles([x.rot_b for x in linkages], (-1, 9)),
        "link_force": doubles([x.force for x in linkages], (-1, 3)),
        "link_torque": doubles([x.torque for x in linkages], (-1, 3)),
        "link_rod": doubles([x.rod for x in linkages], (-1,)),
    }
