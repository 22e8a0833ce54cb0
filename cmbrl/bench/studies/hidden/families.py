"""Robots that are not those of their file: what each family changes in the compiled model.

The families "parameters", "payload" and "floor" stay within what the file can say. "outside" keeps the file and adds
friction loss here; everything else of it no file of the model class can say, so it is in :mod:`.flaws`.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.studies.hidden.plan import DRAW_SEED, FAMILIES, FLOOR, OUTSIDE, PARAMETERS, PAYLOAD, SCENES
from cmbrl.data.recorder import without_mujoco_warnings

SPREAD, FRICTION = 0.3, (0.5, 1.5)  #: of masses, gears and damping; factor on every sliding friction
PAYLOAD_SHARE, PAYLOAD_RADIUS = 0.3, 0.08  #: of the robot's mass; m, of a solid sphere
PAYLOAD_PLACE = {"hopper": ((0.05, 0.15), (-0.15, 0.15)), "cheetah": ((0.1, 0.4), (0.0, 0.1))}
"""scene -> how far before or behind the torso's origin [m], and how far above it [m]"""
TIME_CONSTANT, IMPEDANCE, WIDTH, FLOOR_FRICTION = (0.01, 0.05), (0.7, 0.95), (0.003, 0.03), (0.7, 1.0)
FRICTION_LOSS = (0.01, 0.04)  #: of a motor's largest torque


def generator(scene: str, family: str, draw: int, part: int = 0) -> np.random.Generator:
    """Of one part of one draw; draws do not depend on each other."""
    return np.random.default_rng([DRAW_SEED, SCENES.index(scene), FAMILIES.index(family), draw, part])


def changed(scene: str, path: str, family: str, draw: int) -> mujoco.MjModel:
    """The file's model with the changes of a draw that a file can say: what the oracle is given."""
    with without_mujoco_warnings():
        model = mujoco.MjModel.from_xml_path(path)
    rng = generator(scene, family, draw)
    {PARAMETERS: _parameters, PAYLOAD: _payload, FLOOR: _floor, OUTSIDE: _friction_loss}[family](model, rng, scene)
    mujoco.mj_setConst(model, mujoco.MjData(model))  # what the compiler derives from the rest
    return model


def motor_dofs(model: mujoco.MjModel) -> np.ndarray:
    """Degrees of freedom (nu,) of the driven joints."""
    found: np.ndarray = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    return found


def _parameters(model: Any, rng: np.random.Generator, scene: str) -> None:
    """Every mass (with its inertia), gear and damping by its own factor, all sliding friction by one."""
    low, high = 1 - SPREAD, 1 + SPREAD
    scale = rng.uniform(low, high, model.nbody - 1)
    model.body_mass[1:] *= scale
    model.body_inertia[1:] *= scale[:, None]
    model.actuator_gear[:, 0] *= rng.uniform(low, high, model.nu)
    model.dof_damping[motor_dofs(model)] *= rng.uniform(low, high, model.nu)
    model.geom_friction[:, 0] *= rng.uniform(*FRICTION)


def _payload(model: Any, rng: np.random.Generator, scene: str) -> None:
    """A solid sphere in the torso, off centre in the plane of motion."""
    along, above = PAYLOAD_PLACE[scene]
    place = np.array([rng.choice([-1.0, 1.0]) * rng.uniform(*along), 0.0, rng.uniform(*above)])
    mass = PAYLOAD_SHARE * float(model.body_mass.sum())
    add_sphere(model, model.body("torso").id, mass, PAYLOAD_RADIUS, place)


def add_sphere(model: Any, body: int, mass: float, radius: float, place: np.ndarray) -> None:
    """Adds a solid sphere to a body, at ``place`` (3,) in the body's frame: mass, centre and inertia of both."""
    rotation = np.zeros(9)
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


def _floor(model: Any, rng: np.random.Generator, scene: str) -> None:
    """Softness and friction of all contacts: MuJoCo mixes those of both geoms, so both get them.

    MuJoCo holds a time constant at two time steps or more: on the half-cheetah, those below .02 s are .02 s.
    """
    model.geom_solref[:, 0] = np.exp(rng.uniform(*np.log(TIME_CONSTANT)))
    impedance = rng.uniform(*IMPEDANCE)
    model.geom_solimp[:, 0] *= impedance / model.geom_solimp[:, 1]
    model.geom_solimp[:, 1] = impedance
    model.geom_solimp[:, 2] = np.exp(rng.uniform(*np.log(WIDTH)))
    model.geom_friction[:, 0] = rng.uniform(*FLOOR_FRICTION)


def _friction_loss(model: Any, rng: np.random.Generator, scene: str) -> None:
    torque = np.abs(model.actuator_gear[:, 0])
    model.dof_frictionloss[motor_dofs(model)] = rng.uniform(*FRICTION_LOSS, model.nu) * torque
