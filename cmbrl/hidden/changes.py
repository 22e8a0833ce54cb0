"""What each family of hidden systems changes in a compiled model (``mujoco.MjModel``), for robots in general.

The families "parameters", "payload" and "floor" stay within what a file can say. Of "outside" only friction loss is
here; the rest no file of the model class can say, so it is in :mod:`.flaws`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from cmbrl.errors import UserError

SPREAD, FRICTION = 0.3, (0.5, 1.5)  #: of masses, gears and damping; factor on every sliding friction
PAYLOAD_SHARE, HELD_SHARE = 0.3, 0.1  #: of the robot's mass: in its trunk; at the end of one that is mounted
PAYLOAD_DENSITY = 2000.0  #: kg/m^3, a sphere
PAYLOAD_AHEAD, PAYLOAD_ABOVE = (0.25, 0.75), (0.0, 1.0)  #: of half its body's length, either way; of half its height
TIME_CONSTANT, IMPEDANCE, WIDTH, FLOOR_FRICTION = (0.01, 0.05), (0.7, 0.95), (0.003, 0.03), (0.7, 1.0)
FRICTION_LOSS = (0.01, 0.04)  #: of a motor's largest torque
REACH = 0.2  #: rad or m, off its target: where a servo is taken to give its largest torque, unless a limit is less
_ON_JOINT = [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
_SINGLE = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]


def joint_motors(model: Any) -> np.ndarray:
    """Numbers (n,) of the actuators that drive a hinge or slide."""
    on_joint = np.flatnonzero(np.isin(model.actuator_trntype, _ON_JOINT))
    found: np.ndarray = on_joint[np.isin(model.jnt_type[model.actuator_trnid[on_joint, 0]], _SINGLE)]
    return found


def motor_dofs(model: Any) -> np.ndarray:
    """Degrees of freedom (n,) of the driven hinges and slides, by actuator."""
    found: np.ndarray = model.jnt_dofadr[model.actuator_trnid[joint_motors(model), 0]]
    return found


def strengths(model: Any) -> np.ndarray:
    """Largest torques or forces (n,) of ``joint_motors`` at their joints [N m, N], by the limits of the file."""
    return np.array([_strength(model, int(k)) for k in joint_motors(model)])


def _strength(model: Any, k: int) -> float:
    gear, gain = abs(float(model.actuator_gear[k, 0])), abs(float(model.actuator_gainprm[k, 0]))
    joint = model.actuator_trnid[k, 0]
    limits = []
    if model.actuator_forcelimited[k]:
        limits.append(gear * float(np.abs(model.actuator_forcerange[k]).max()))
    if model.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    if _plain(model)[k] and model.actuator_ctrllimited[k]:
        limits.append(gear * gain * float(np.abs(model.actuator_ctrlrange[k]).max()))
    if not _plain(model)[k]:  # files limit servos by numbers that no motor has, such as 1,000 N m at a quadruped's hip
        limits.append(gear * gain * gear * REACH)
    return min(limits, default=gear * gain)


def _plain(model: Any) -> np.ndarray:
    """(nu,) bool: motors, whose force is the control times a gain."""
    found: np.ndarray = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_NONE)
    return found


def parameters(model: Any, rng: np.random.Generator) -> None:
    """Every mass (with its inertia), motor's strength and damping by its own factor, all sliding friction by one.

    Of a servo the gains change together: it still holds its targets.
    """
    low, high = 1 - SPREAD, 1 + SPREAD
    scale = rng.uniform(low, high, model.nbody - 1)
    model.body_mass[1:] *= scale
    model.body_inertia[1:] *= scale[:, None]
    strength, plain, driven = rng.uniform(low, high, model.nu), _plain(model), motor_dofs(model)
    model.actuator_gear[plain, 0] *= strength[plain]
    model.actuator_gainprm[~plain, 0] *= strength[~plain]
    model.actuator_biasprm[~plain, :3] *= strength[~plain, None]
    model.dof_damping[driven] *= rng.uniform(low, high, len(driven))
    factor = rng.uniform(*FRICTION)
    model.geom_friction[:, 0] *= factor
    model.pair_friction[:, :2] *= factor


def payload(model: Any, rng: np.random.Generator) -> None:
    """A solid sphere off the centre of the trunk, or of the last link of a robot that is mounted."""
    body, is_trunk = carrier(model)
    centre, half = _extent(model, body)
    ahead, above = rng.choice([-1.0, 1.0]) * rng.uniform(*PAYLOAD_AHEAD), rng.uniform(*PAYLOAD_ABOVE)
    mass = (PAYLOAD_SHARE if is_trunk else HELD_SHARE) * float(model.body_subtreemass[model.body_rootid[body]])
    radius = float((mass / PAYLOAD_DENSITY * 0.75 / np.pi) ** (1 / 3))
    add_sphere(model, body, mass, radius, centre + half * np.array([ahead, 0.0, above]))


def carrier(model: Any) -> tuple[int, bool]:
    """The body that a payload goes on, and whether it is the trunk: the first that moves, where no motor moves it.

    Else it is the last body of the longest chain. Raises UserError for a file in which nothing moves.
    """
    moving = np.flatnonzero(model.body_dofnum > 0)
    if not len(moving):
        raise UserError("nothing in the file moves, so that nothing carries a payload: choose another family")
    first = int(moving[0])
    dofs = range(model.body_dofadr[first], model.body_dofadr[first] + model.body_dofnum[first])
    if not set(dofs) <= set(motor_dofs(model).tolist()):
        return first, True
    return max(moving.tolist(), key=lambda body: _depth(model, body)), False


def _depth(model: Any, body: int) -> int:
    return 0 if body == 0 else 1 + _depth(model, int(model.body_parentid[body]))


def _extent(model: Any, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Centre (3,) and half lengths (3,) [m] in the body's frame of the box around its shapes; a point without any."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in np.flatnonzero(model.geom_bodyid == body):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        axes, box = rotation.reshape(3, 3), model.geom_aabb[geom]
        middle, half = model.geom_pos[geom] + axes @ box[:3], np.abs(axes) @ box[3:]
        low, high = np.minimum(low, middle - half), np.maximum(high, middle + half)
    if not np.isfinite(low).all():
        return model.body_ipos[body].copy(), np.zeros(3)
    return (low + high) / 2, (high - low) / 2


def add_sphere(model: Any, body: int, mass: float, radius: float, place: Sequence[float] | np.ndarray) -> None:
    """Adds a solid sphere to a body, at ``place`` (3,) in the body's frame: mass, centre and inertia of both."""
    rotation, place = np.zeros(9), np.asarray(place, dtype=float)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    axes = rotation.reshape(3, 3)
    own, centre = float(model.body_mass[body]), model.body_ipos[body].copy()
    together = (own * centre + mass * place) / (own + mass)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T + 0.4 * mass * radius**2 * np.eye(3)
    for weight, at in ((own, centre - together), (mass, place - together)):
        inertia += weight * (at @ at * np.eye(3) - np.outer(at, at))
    values, vectors = np.linalg.eigh(inertia)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))  # a rotation, no reflection
    mujoco.mju_mat2Quat(model.body_iquat[body], vectors.ravel())
    model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = own + mass, together, values
    # MuJoCo skips the inertial frame of a body where the compiler found it to be the body's own.
    model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


def floor(model: Any, rng: np.random.Generator) -> None:
    """Softness and friction of all contacts: MuJoCo mixes those of both geoms, so both get them.

    MuJoCo holds a time constant at two time steps or more: on the half-cheetah, those below .02 s are .02 s.
    """
    time, impedance = np.exp(rng.uniform(*np.log(TIME_CONSTANT))), rng.uniform(*IMPEDANCE)
    width, friction = np.exp(rng.uniform(*np.log(WIDTH))), rng.uniform(*FLOOR_FRICTION)
    for solref, solimp in ((model.geom_solref, model.geom_solimp), (model.pair_solref, model.pair_solimp)):
        solref[:, 1] = np.where(solref[:, 0] < 0, 1.0, solref[:, 1])  # the file's stiffness and damping: now a time
        solref[:, 0] = time
        solimp[:, 0] *= impedance / solimp[:, 1]
        solimp[:, 1], solimp[:, 2] = impedance, width
    model.geom_friction[:, 0] = friction
    model.pair_friction[:, :2] = friction


def friction_loss(model: Any, rng: np.random.Generator) -> None:
    """Dry friction of driven joints, on top of the file's."""
    driven = motor_dofs(model)
    model.dof_frictionloss[driven] += rng.uniform(*FRICTION_LOSS, len(driven)) * strengths(model)
