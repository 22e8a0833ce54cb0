"""Actuators on several dofs at once: on a site, on all dofs of a ball or free joint, or at the contacts of a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import WORLD, Array, Tree
from cmbrl.scene.reduction import PlaneOfMotion


@dataclass(frozen=True)
class Reach:
    """How an actuator acts on several dofs, per unit of its force.

    By a wrench on a body, by moment arms at a joint, or by a pull along the mean of the normals of a body's contacts.
    """

    body: int  # WORLD: at a joint
    moment: Array  # (3,) about the origin of the body, in its axes
    force: Array  # (3,)
    dofs: range
    arms: Array
    grips: int | None = None  # the body of the file at whose contacts it pulls


def read_reach(model: mujoco.MjModel, tree: Tree, k: int) -> Reach:
    """That of actuator ``k``, which acts along no line."""
    gear, number = model.actuator_gear[k], int(model.actuator_trnid[k, 0])
    zero, none = np.zeros(3), np.zeros(0)
    if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_BODY:
        return Reach(tree.frames[number].body, zero, zero, range(0), none, grips=number)
    if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_SITE:
        frame = tree.frames[model.site_bodyid[number]]
        pos = frame.pos + frame.rot @ model.site_pos[number]
        rot = frame.rot @ quaternion_matrix(model.site_quat[number])
        force = rot @ gear[:3]
        return Reach(frame.body, rot @ gear[3:] + np.cross(pos, force), force, range(0), none)
    first, count = int(model.jnt_dofadr[number]), 3 if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_BALL else 6
    return Reach(WORLD, zero, zero, range(first, first + count), gear[:count].copy())


def reach_arrays(
    model: mujoco.MjModel,
    tree: Tree,
    reaches: Sequence[Reach | None],
    candidates: CandidateTable,
    plane: PlaneOfMotion | None,
) -> dict[str, Any]:
    """For the core, in the plane of motion if there is one; ``reaches`` by actuator."""
    wide = [(k, reach) for k, reach in enumerate(reaches) if reach]
    local = []
    for _, reach in wide:
        if plane:
            moment = tree.turn(reach.body, reach.moment) @ plane.axis
            local.append(np.concatenate([[moment], plane.local(tree, reach.body, reach.force)]))
        else:
            local.append(np.concatenate([reach.moment, reach.force]))
    grips = [_contacts_of(model, reach.grips, candidates) for _, reach in wide]
    return {
        "nwide": len(wide),
        "wide_act": integers([k for k, _ in wide]),
        "wide_body": integers([reach.body for _, reach in wide]),
        "wide_local": doubles(local, (-1, 3 if plane else 6)),
        "wide_ptr": integers(np.cumsum([0, *(len(reach.dofs) for _, reach in wide)])),
        "wide_dof": integers([d for _, reach in wide for d in reach.dofs]),
        "wide_coef": doubles([x for _, reach in wide for x in reach.arms], (-1,)),
        "grip_ptr": integers(np.cumsum([0, *map(len, grips)])),
        "grip_con": integers([c for of_one in grips for c in of_one]),
    }


def _contacts_of(model: mujoco.MjModel, body: int | None, candidates: CandidateTable) -> list[int]:
    """Numbers of the candidates of a body of the file."""
    if body is None:
        return []
    return np.flatnonzero(np.any(model.geom_bodyid[candidates.geoms] == body, axis=1)).tolist()
