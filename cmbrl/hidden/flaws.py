"""What no file of the model class says: late commands, slow motors, backlash, another integrator, noisy sensors.

Backlash is a joint of its own, between motor and link: driven joint and play share axis and place, the play turns
freely within its gap and meets stiff stops at the ends. The driven joint carries the motor: its torque, damping,
friction loss, springs and the armature. Encoders sit on the motor's side, so that no one sees the play. A hinge without
an armature has none: nothing would be left to move within the gap.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.hidden.changes import joint_motors, motor_dofs, strengths
from cmbrl.scene.drives import Drive, driven_model
from cmbrl.scene.fittable.play import SUFFIX

STEP = 1e-3  #: s, Euler; implicit where the file is, as for servos whose damping explicit steps would not bear
IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
LAG = 0.02  #: s, of the torque behind the command, first order
DELAY = (1.0, 2.0)  #: control steps
GAP = (0.3, 1.0)  #: degrees, of the backlash from stop to stop
PLAY_ARMATURE, PLAY_DAMPING = 0.02, 0.002  #: of the driven joint's armature; N m s/rad per N m of the motor
STOP, STOP_IMPEDANCE = (0.004, 1.0), (0.95, 0.99, 1e-3, 0.5, 2.0)  #: solref and solimp of the play's ends
ANGLE, RATE = 5e-4, 0.05  #: rad and rad/s, of joint encoders of 14 bits and their differences
PITCH, GYRO = 2e-3, 0.02  #: rad and rad/s, of an IMU and its filter
PLACE, SPEED = 2e-3, 0.02  #: m and m/s, of the base by motion capture


@dataclass(frozen=True)
class Flaws:
    """Of one robot: ``late`` physics steps between command and motor; noise (nv,) of measured positions, velocities.

    That of a quaternion is a small rotation.
    """

    late: int = 0
    noise_q: np.ndarray | None = None
    noise_v: np.ndarray | None = None


def flawed(
    path: str | os.PathLike[str],
    file_like: mujoco.MjModel,
    dt: float,
    rng: np.random.Generator,
    drives: Sequence[Drive] = (),
) -> tuple[mujoco.MjModel, Flaws]:
    """The robot of the file at ``path`` under ``drives`` with the friction loss of ``file_like`` and drawn flaws.

    dt: the control step [s].
    """
    spec = mujoco.MjSpec.from_file(os.fspath(path))
    spec.option.timestep = dt / max(1, math.ceil(dt / STEP - 1e-6))
    if spec.option.integrator not in [int(kind) for kind in IMPLICIT]:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    for motor in spec.actuators:
        if motor.dyntype == mujoco.mjtDyn.mjDYN_NONE:
            motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            motor.dynprm[0] = LAG
    torques = dict(zip(motor_dofs(file_like).tolist(), strengths(file_like), strict=True))
    driven = [file_like.joint(int(file_like.actuator_trnid[k, 0])) for k in joint_motors(file_like)]
    loose = {joint.name: torques[int(joint.dofadr[0])] for joint in driven if _can_play(file_like, joint.id)}
    for name, torque in loose.items():
        _add_play(spec.joint(name), float(torque))
    for key in list(spec.keys):  # poses of fewer joints
        spec.delete(key)
    with warnings.catch_warnings():  # about the style of a scene by others
        warnings.simplefilter("ignore")
        model = driven_model(spec.compile(), drives, os.fspath(path))
    gaps = np.deg2rad(rng.uniform(*GAP, len(driven)))
    for joint, gap in zip(driven, gaps, strict=True):
        if joint.name in loose:
            model.joint(play_of(joint.name)).range[:] = -gap / 2, gap / 2  # in radians, whatever the file's unit
    for own, other in zip(motor_dofs(model), motor_dofs(file_like), strict=True):
        model.dof_frictionloss[own] = file_like.dof_frictionloss[other]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    size = rng.uniform(0.5, 1.5)
    late = round(rng.uniform(*DELAY) * dt / model.opt.timestep)
    return model, Flaws(late, *(size * noise for noise in noise_of(file_like)))


def lagging(model: mujoco.MjModel) -> np.ndarray:
    """(nu,) bool: actuators to which ``flawed`` has given a lag."""
    exact = model.actuator_dyntype == int(mujoco.mjtDyn.mjDYN_FILTEREXACT)
    found: np.ndarray = exact & (model.actuator_dynprm[:, 0] == LAG)
    return found


def play_of(joint: str) -> str:
    """Name of the play behind a driven joint."""
    return f"{joint}{SUFFIX}"


def _can_play(model: mujoco.MjModel, joint: int) -> bool:
    hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
    return bool(hinge and model.dof_armature[model.jnt_dofadr[joint]] > 0.0 and model.joint(joint).name)


def _add_play(joint: mujoco.MjsJoint, torque: float) -> None:
    joint.parent.add_joint(
        name=play_of(joint.name), type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, pos=joint.pos,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE, range=(-1.0, 1.0), solref_limit=STOP, solimp_limit=STOP_IMPEDANCE,
        armature=PLAY_ARMATURE * joint.armature, damping=(PLAY_DAMPING * torque, 0.0, 0.0), stiffness=(0.0, 0.0, 0.0),
        frictionloss=0.0,
    )  # fmt: skip


def noise_of(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (nv,), (nv,) of positions and velocities: slides and free bodies, turns, driven hinges."""
    encoders = set(motor_dofs(model).tolist())
    q, v = np.empty(model.nv), np.empty(model.nv)
    for joint in range(model.njnt):
        at, kind = int(model.jnt_dofadr[joint]), mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            q[at : at + 6], v[at : at + 6] = np.repeat([PLACE, PITCH], 3), np.repeat([SPEED, GYRO], 3)
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            q[at : at + 3], v[at : at + 3] = PITCH, GYRO
        elif kind == mujoco.mjtJoint.mjJNT_SLIDE:
            q[at], v[at] = PLACE, SPEED
        else:
            q[at], v[at] = (ANGLE, RATE) if at in encoders else (PITCH, GYRO)
    return q, v
