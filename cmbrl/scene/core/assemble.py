"""Arrays of the C++ core for the tree, its lines with their limits, and contacts, from the records of a scene."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.collision.shapes import Shape
from cmbrl.scene.forces.linkages import Linkage, inverse_weights, linkage_arrays
from cmbrl.scene.forces.tendons import segment_arrays
from cmbrl.scene.laws import CONTACT_LAWS
from cmbrl.scene.records import WORLD, Array, JointKind, Tendon, Tree
from cmbrl.scene.reduction import PlaneOfMotion
from cmbrl.scene.source.mjcf import limits_act
from cmbrl.scene.source.solref import acting

Arrays = dict[str, Any]

_LEAST = 1e-6  # of the least inverse weight of a joint


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


def line_arrays(
    model: mujoco.MjModel,
    tree: Tree,
    tendons: list[Tendon],
    linkages: list[Linkage],
    plane: PlaneOfMotion | None,
) -> Arrays:
    """Tendons and linkages, and dry friction and limits of joints and tendons."""
    source = [tendon.source for tendon in tendons]
    slack = np.diff(model.tendon_lengthspring[source]).reshape(-1)
    dofs = [tendon.dofs for tendon in tendons] + [linkage.dofs for linkage in linkages]
    coefs = [tendon.coefs for tendon in tendons] + [x.coefs or (0.0,) * len(x.dofs) for x in linkages]
    more, moved = len(linkages), inverse_weights(model, linkages)  # without springs and dry friction
    return {
        "tendon_ptr": integers(np.cumsum([0, *map(len, dofs)])),
        "tendon_dof": integers([dof for each in dofs for dof in each]),
        "tendon_coef": doubles([coef for each in coefs for coef in each], (-1,)),
        **segment_arrays(tree, tendons, more, plane),
        **linkage_arrays(linkages, int(model.nv) + len(tendons)),
        "line_soft": _stack(
            np.hstack([acting(model.dof_solref), model.dof_solimp]),
            np.hstack([acting(model.tendon_solref_fri[source]), model.tendon_solimp_fri[source]]),
            np.zeros((more, 7)),
        ),
        "line_invweight": _stack(model.dof_invweight0, _tendon_weights(model)[source], moved),
        "line_slack": _stack(np.zeros(model.nv), slack, np.zeros(more)),
        **_limit_arrays(model, tree, tendons),
    }


def _stack(*parts: Array) -> Array:
    return np.ascontiguousarray(np.concatenate(parts), dtype=np.float64)


def _tendon_weights(model: mujoco.MjModel) -> Array:
    """MuJoCo's inverse weights of tendons, with a floor above its own, which a solve can bear.

    One is 0 where no joint changes the tendon's length at qpos0: one that a body only touches elsewhere.
    """
    return np.maximum(model.tendon_invweight0, _LEAST * model.dof_invweight0.min())


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
    of_joints = np.hstack([acting(model.jnt_solref[source]), model.jnt_solimp[source]])
    of_tendons = np.hstack([acting(model.tendon_solref_lim[which]), model.tendon_solimp_lim[which]])
    return {
        "lim_line": integers([*dofs, *lines]),
        "lim_ball": integers([j.qadr if j.kind == JointKind.BALL else -1 for j in limited] + [-1] * len(lines)),
        "lim_lo": doubles(ranges[:, 0], (-1,)),
        "lim_hi": doubles(ranges[:, 1], (-1,)),
        "lim_margin": _stack(model.jnt_margin[source], model.tendon_margin[which]),
        "lim_soft": _stack(of_joints, of_tendons),
        "lim_invweight": _stack(model.dof_invweight0[dofs], _tendon_weights(model)[which]),
    }


def contact_arrays(
    model: mujoco.MjModel,
    candidates: CandidateTable,
    planes: list[Shape],
    plane: PlaneOfMotion | None,
    contact_law: str,
) -> Arrays:
    """Contact candidates, and the planes that they may touch."""
    dimension = 2 if plane else 3
    flat, square, count = (dimension,), (dimension, dimension), len(candidates)
    normals = np.array([ground.rot[:, 2] for ground in planes]).reshape(-1, 3)
    number = np.full(model.ngeom, -1)
    number[[ground.geom for ground in planes]] = np.arange(len(planes))
    pyramid = int(model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL)
    solimp = candidates.of_laws("solimp").reshape(-1, 5)
    return {
        "con_type": integers(candidates.kind),
        "con_bodyA": integers(candidates.bodies[:, 0]),
        "con_bodyB": integers(candidates.bodies[:, 1]),
        "con_plane": integers(np.where(candidates.on_plane, number[candidates.geoms[:, 1]], -1)),
        "con_pair": integers(candidates.pairs[1]),
        "con_posA": doubles(candidates.vectors("pos_a", flat), (-1, dimension)),
        "con_axisA": doubles(candidates.vectors("axis_a", flat), (-1, dimension)),
        "con_posB": doubles(candidates.vectors("pos_b", flat), (-1, dimension)),
        "con_axisB": doubles(candidates.vectors("axis_b", flat), (-1, dimension)),
        "con_rotB": doubles(candidates.vectors("rot_b", square), (-1, dimension**2)),
        "con_halfB": doubles(candidates.vectors("half_b", flat), (-1, dimension)),
        "con_rotA": doubles(candidates.vectors("rot_a", square), (-1, dimension**2)),
        "con_along": doubles(candidates.vectors("along", (3,)), (-1, 3)),
        "con_when": integers(candidates.when),
        "con_radiusB": doubles(candidates.radii[:, 1], (-1,)),
        "con_dim": integers(candidates.of_laws("dim")),
        "con_law": integers(np.full(count, CONTACT_LAWS[contact_law])),
        "con_pyramid": integers(pyramid * candidates.of_laws("edges")),
        "con_ratio": doubles(candidates.of_laws("ratios"), (-1, 2)),
        "con_impratio": doubles(np.full(count, float(model.opt.impratio)), (-1,)),
        "con_invweight": doubles(candidates.of_laws("inverse_weight"), (-1,)),
        "con_margin": doubles(candidates.of_laws("margin"), (-1,)),
        "con_reach": doubles(candidates.of_laws("reach"), (-1,)),
        "con_points": doubles(candidates.weight, (-1,)),
        "con_mid": doubles(solimp[:, 3], (-1,)),
        "con_power": doubles(solimp[:, 4], (-1,)),
        "plane_normal": doubles(normals @ plane.basis.T if plane else normals, (-1, dimension)),
    }
