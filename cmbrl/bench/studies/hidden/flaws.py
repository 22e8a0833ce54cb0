"""What no file of the model class says: late commands, slow motors, backlash, another integrator, noisy sensors.

Backlash is a joint of its own, between motor and link: driven joint and play share axis and place, the play turns
freely within its gap and meets stiff stops at the ends. The driven joint carries the motor: its torque, damping,
friction loss, springs and the armature. Encoders sit on the motor's side, so that no one sees the play.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.bench.studies.hidden.families import generator, motor_dofs
from cmbrl.bench.studies.hidden.plan import OUTSIDE

STEP = 1e-3  #: s, Euler
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
    """Of one robot: ``late`` physics steps between command and motor; noise (nq,), (nv,) of what is measured."""

    late: int = 0
    noise_q: np.ndarray | None = None
    noise_v: np.ndarray | None = None


def flawed(scene: str, path: str, file_like: mujoco.MjModel, draw: int, dt: float) -> tuple[mujoco.MjModel, Flaws]:
    """The robot of the file at ``path`` with the friction loss of ``file_like`` and the flaws of a draw.

    dt: the control step [s].
    """
    rng = generator(scene, OUTSIDE, draw, part=1)
    spec = mujoco.MjSpec.from_file(path)
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    for motor in spec.actuators:
        motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        motor.dynprm[0] = LAG
        _add_play(spec.joint(motor.target), abs(float(motor.gear[0])))
    with warnings.catch_warnings():  # about the style of a scene by others
        warnings.simplefilter("ignore")
        model = spec.compile()
    gaps = np.deg2rad(rng.uniform(*GAP, file_like.nu))
    for k, gap in enumerate(gaps):
        driven = file_like.joint(int(file_like.actuator_trnid[k, 0])).name
        model.joint(play_of(driven)).range[:] = -gap / 2, gap / 2  # in radians, whatever the file's unit
        model.joint(driven).frictionloss[:] = file_like.dof_frictionloss[motor_dofs(file_like)[k]]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    size = rng.uniform(0.5, 1.5)
    late = round(rng.uniform(*DELAY) * dt / STEP)
    return model, Flaws(late, *(size * noise for noise in _noise(file_like)))


def play_of(joint: str) -> str:
    """Name of the play behind a driven joint."""
    return f"{joint}_play"


def _add_play(joint: mujoco.MjsJoint, torque: float) -> None:
    joint.parent.add_joint(
        name=play_of(joint.name), type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, pos=joint.pos,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE, range=(-1.0, 1.0), solref_limit=STOP, solimp_limit=STOP_IMPEDANCE,
        armature=PLAY_ARMATURE * joint.armature, damping=(PLAY_DAMPING * torque, 0.0, 0.0), stiffness=(0.0, 0.0, 0.0),
        frictionloss=0.0,
    )  # fmt: skip


def _noise(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (nq,), (nv,) of a planar robot: slides of the base, its pitch, then joints."""
    slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    joints = np.isin(np.arange(model.njnt), model.actuator_trnid[:, 0])
    q = np.where(slides, PLACE, np.where(joints, ANGLE, PITCH))
    v = np.where(slides, SPEED, np.where(joints, RATE, GYRO))
    return q, v
