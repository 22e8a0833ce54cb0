"""Three G1 whose real robot is not the one of the file: a fit has to find out from a log.

The model starts from the published file. What differs is drawn from the ranges in which BeyondMimic and Bundled Contact
Gradients randomise their robot in training (Liao et al., arXiv 2508.08241; Aditya et al., arXiv 2609.30951); for joint
damping and friction loss, which the file has not, the ranges are ours.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from cmbrl.imitation.robot import imitation_task
from cmbrl.tasks.g1 import ROBOT, _warm_up

FRICTION = (0.3, 1.2)
BASE_MASS = 3.0  # kg more or less
LINK_MASS, GAIN, ARMATURE = (0.8, 1.2), (0.8, 1.2), (0.75, 1.25)  # times the file's
TORSO_SHIFT = (0.025, 0.05, 0.05)  # m, of the centre of mass either way
DAMPING = 0.2  # of a servo's damping, at most
FRICTION_LOSS = 0.01  # of a joint's torque limit, at most


def change(model: Any, draw: int) -> None:
    """Draws another robot into the compiled ``model`` (mujoco.MjModel)."""
    import mujoco

    rng = np.random.default_rng([13, draw])
    bodies = slice(1, model.nbody)
    scale = rng.uniform(*LINK_MASS, model.nbody - 1)
    model.body_mass[bodies] *= scale
    model.body_inertia[bodies] *= scale[:, None]
    pelvis, torso = model.body("pelvis").id, model.body("torso_link").id
    model.body_mass[pelvis] = max(0.5, model.body_mass[pelvis] + rng.uniform(-BASE_MASS, BASE_MASS))
    model.body_ipos[torso] += rng.uniform(-1.0, 1.0, 3) * TORSO_SHIFT
    model.geom_friction[:, 0] = rng.uniform(*FRICTION)
    gain, damping = rng.uniform(*GAIN, (2, model.nu))
    servo_damping = -model.actuator_biasprm[:, 2].copy()
    model.actuator_gainprm[:, 0] *= gain
    model.actuator_biasprm[:, 1] *= gain
    model.actuator_biasprm[:, 2] *= damping
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    model.dof_armature[dofs] *= rng.uniform(*ARMATURE, model.nu)
    model.dof_damping[dofs] = rng.uniform(0.0, DAMPING, model.nu) * servo_damping
    limits = np.abs(model.actuator_forcerange).min(axis=1)
    model.dof_frictionloss[dofs] = rng.uniform(0.0, FRICTION_LOSS, model.nu) * limits
    mujoco.mj_setConst(model, mujoco.MjData(model))


TASKS = [
    imitation_task(
        f"g1_hidden_{k}",
        f"Unitree G1 whose real robot differs from the file, draw {k}: fit it, then train on the fit",
        ROBOT,
        _warm_up,
        change=partial(change, draw=k),
    )
    for k in range(3)
]
FIRST, SECOND, THIRD = TASKS
