"""What a program that runs an imitating policy needs besides its net: reference, order of observations, gains.

At frame k of the motion the policy observes ``observation_parts``, in this order, and its action moves the servos'
targets: control = control_per_target (targets[min(k + 1, F - 1)] + action_scale action), clipped to control_range.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cmbrl.imitation import joints
from cmbrl.scene.records import Array

if TYPE_CHECKING:
    from cmbrl.imitation.tracking import Tracking


def arrays(tracking: Tracking) -> dict[str, Array]:
    """Arrays by name, over F frames a control step ``dt`` [s] apart.

    - joint_names (n,) after the root, actuator_names (nu,), tracked bodies and which of them is the anchor.
    - observation_parts (p,) and observation_sizes (p,): what is observed, one part after the other.
    - reference_q (F, nq) and reference_v (F, nv) in MuJoCo's layout; reference_anchor_position (F, 3) [m] and
      reference_anchor_rotation (F, 3, 3), to the world.
    - posture (n,), which observed positions are relative to.
    - targets (F, nu) of the servos along the reference, action_scale (nu,) [rad or m], control_per_target (nu,) and
      control_range (nu, 2).
    """
    scene, motion, n = tracking.scene, tracking.motion, len(tracking.posture)
    root = {"root_linear_velocity_in_root": 3, "root_angular_velocity_in_root": 3} if tracking.root_v else {}
    parts = {
        "reference_joint_positions": n,
        "reference_joint_velocities": n,
        "reference_anchor_position_in_anchor": 3,
        "reference_anchor_rotation_in_anchor_by_rows_of_two_columns": 6,
        **root,
        "joint_positions_minus_posture": n,
        "joint_velocities": n,
        "last_action": tracking.nu,
    }
    anchor = tracking.reference.motion
    return {
        "dt": np.array(tracking.dt),
        "joint_names": np.array(joints.joint_names(scene)),
        "actuator_names": np.array(scene.actuator_names),
        "anchor": np.array(tracking.bodies.names[tracking.anchor]),
        "observation_parts": np.array(list(parts)),
        "observation_sizes": np.array(list(parts.values())),
        "reference_q": motion.q,
        "reference_v": motion.v,
        "reference_anchor_position": anchor.position[:, tracking.anchor].numpy(),
        "reference_anchor_rotation": anchor.rotation[:, tracking.anchor].numpy(),
        "posture": tracking.posture.numpy(),
        "targets": tracking.targets.numpy(),
        "action_scale": tracking.scale.numpy(),
        "control_per_target": tracking.factor.numpy(),
        "control_range": np.reshape(scene.core.act_ctrl, (-1, 2)),
    }
