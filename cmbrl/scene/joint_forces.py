"""Forces at joints besides springs, dampers and single actuators: limits on the sum of the actuators of a joint."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.assemble import doubles, integers
from cmbrl.scene.mjcf import name_of
from cmbrl.scene.support import Gate


def force_ranges(model: mujoco.MjModel, gate: Gate) -> dict[str, Any]:
    """The dofs whose joint clamps the sum of its actuators, and the ranges (nf, 2) [N, N m]; for the core."""
    scalar = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    found = []
    for k in np.flatnonzero(model.jnt_actfrclimited):
        low, high = model.jnt_actfrcrange[k]
        why = f"actuatorfrcrange {low:g} {high:g}"
        if int(model.jnt_type[k]) in scalar and not gate.drops(
            "joint_force_range", name_of(model, "joint", int(k)), why, "forces are not clamped"
        ):
            found.append(int(k))
    return {
        "nforcerange": len(found),
        "frc_dof": integers(model.jnt_dofadr[found]),
        "frc_range": doubles(model.jnt_actfrcrange[found], (-1, 2)),
    }
