"""Springs that turn ball joints back, and springs and dampers with higher powers."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.records import Array, JointKind, Tree
from cmbrl.scene.source.mjcf import name_of
from cmbrl.scene.source.support import Gate

_BALLS = (mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_FREE)


def check_joints(model: mujoco.MjModel, gate: Gate) -> None:
    """Refuses what is not modelled. What the gate leaves out is set to zero in ``model``."""
    stiffness, damping = powers(model, "jnt_stiffnesspoly", model.njnt), powers(model, "dof_dampingpoly", model.nv)
    for k in range(model.njnt):
        name, ball = name_of(model, "joint", k), int(model.jnt_type[k]) in _BALLS
        dofs = model.dof_jntid == k
        if ball and model.jnt_limited[k]:
            angle = float(np.degrees(model.jnt_range[k].max()))
            if gate.drops("joint_limit_ball", name, f"its angle is limited to {angle:.4g} degrees"):
                model.jnt_limited[k] = 0
        if ball and model.jnt_stiffness[k]:
            why = f"stiffness {model.jnt_stiffness[k]:g}"
            if gate.drops("joint_spring_ball", name, why):
                model.jnt_stiffness[k] = 0.0
        if not (stiffness[k].any() or damping[dofs].any()):
            continue
        if ball and stiffness[k].any():
            gate.refuse(
                "joint_polynomial", name, "a nonlinear spring of a ball or free joint", "reduced to its linear term"
            )
        elif not gate.drops("joint_polynomial", name, "nonlinear spring or damper", "reduced to the linear term"):
            continue
        model.jnt_stiffnesspoly[k] = 0.0
        model.dof_dampingpoly[dofs] = 0.0


def powers(model: mujoco.MjModel, field: str, rows: int) -> Array:
    """Coefficients (rows, 2) of the higher powers; zeros if this version of MuJoCo lacks them."""
    values = getattr(model, field, None)
    return np.zeros((rows, 2)) if values is None or not rows else np.asarray(values).reshape(rows, -1)[:, :2]


def _of_actuators(model: mujoco.MjModel) -> Array:
    """Coefficients (nv, 2) of the nonlinear damping that actuators add to the dofs of their joints."""
    found, on_joint = np.zeros((model.nv, 2)), (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    own = powers(model, "actuator_dampingpoly", len(model.actuator_trntype))
    for k in np.flatnonzero(own.any(axis=1)):
        if int(model.actuator_trntype[k]) in [int(kind) for kind in on_joint]:
            found[model.dof_jntid == model.actuator_trnid[k, 0]] += own[k] * model.actuator_gear[k, 0] ** 2
    return found


def spring_arrays(model: mujoco.MjModel, tree: Tree) -> dict[str, Any]:
    """Springs of ball joints, and the dofs with higher powers, for the core."""
    off, flags = mujoco.mjtDisableBit, model.opt.disableflags
    balls = [j for j in tree.joints if j.kind == JointKind.BALL and model.jnt_stiffness[j.source]]
    balls = balls if not flags & off.mjDSBL_SPRING else []
    stiffness = powers(model, "jnt_stiffnesspoly", model.njnt)[model.dof_jntid] * (not flags & off.mjDSBL_SPRING)
    damping = (powers(model, "dof_dampingpoly", model.nv) + _of_actuators(model)) * (not flags & off.mjDSBL_DAMPER)
    coefs = np.hstack([stiffness, damping])
    bent = np.flatnonzero(coefs.any(axis=1))
    references = [model.qpos_spring[j.qadr : j.qadr + 4] for j in balls]
    return {
        "nballspring": len(balls),
        "spring_dof": integers([j.vadr for j in balls]),
        "spring_qadr": integers([j.qadr for j in balls]),
        "spring_ref": doubles([x / np.linalg.norm(x) for x in references], (-1, 4)),
        "npower": len(bent),
        "power_dof": integers(bent),
        "power_coef": doubles(coefs[bent], (-1, 4)),
    }
