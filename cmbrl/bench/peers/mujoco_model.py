"""MuJoCo's step as a next-state model, with the parameters of our scene written into its compiled model."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import mujoco
import numpy as np
import torch
from mujoco import rollout
from torch import Tensor

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.bench.peers.mujoco_steps import STATE
from cmbrl.errors import UserError

JOINT_FIELDS = {"damping": "dof_damping", "armature": "dof_armature", "frictionloss": "dof_frictionloss"}
GROUPS = (
    *("mass", "com_x", "com_y", "com_z", "damping", "armature", "stiffness", "frictionloss"),
    *("friction", "gear", "gravity"),
)
"""Parameter groups that mean the same in MuJoCo; contact softness, radii and plane heights do not."""


def robot_model(path: str, integrator: str | None = None) -> mujoco.MjModel:
    """The MJCF compiled, with another ``integrator`` of ``cmbrl.bench.peers.mujoco.INTEGRATORS`` where given.

    Planes lose their friction, so that every contact has the friction of the robot's geom. MuJoCo takes the larger
    coefficient of two geoms, so the robot's geoms first get at least the plane's.
    """
    model = compiled(path, integrator)
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    for plane in np.flatnonzero(planes):
        model.geom_friction[~planes] = np.maximum(model.geom_friction[~planes], model.geom_friction[plane])
    model.geom_friction[planes, 0] = 0.0
    return model


def with_parameters(base: mujoco.MjModel, values: Mapping[str, float]) -> mujoco.MjModel:
    """A copy of ``base`` with ``values`` of parameters by their names in ``scene.parameters``.

    Mass (with inertia), gear and gravity are factors on the values of ``base``. What MuJoCo's compiler derives from
    parameters is updated. Raises UserError for a parameter outside :data:`GROUPS`.
    """
    model = copy.copy(base)
    for name, value in values.items():
        group, _, of = name.partition(".")
        if group == "mass":
            body = model.body(of).id
            model.body_mass[body] *= value
            model.body_inertia[body] *= value
        elif group.startswith("com_") and group in GROUPS:
            model.body_ipos[model.body(of).id, "xyz".index(group[-1])] += value
        elif group in JOINT_FIELDS:
            joint = model.joint(of)
            getattr(model, JOINT_FIELDS[group])[joint.dofadr[0] : joint.dofadr[0] + len(joint.damping)] = value
        elif group == "stiffness":
            model.jnt_stiffness[model.joint(of).id] = value
        elif group == "friction":
            model.geom_friction[model.geom(of).id, 0] = value
        elif group == "gear":
            model.actuator_gear[_motor(model, of)] *= value
        elif group == "gravity":
            model.opt.gravity[:] *= value
        else:
            raise UserError(f"a compiled MuJoCo model has no parameter {name!r}; choose from {GROUPS}")
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _motor(model: mujoco.MjModel, name: str) -> int:
    """Number of the actuator called ``name``; an actuator without a name has its joint's."""
    for k in range(model.nu):
        if name in (model.actuator(k).name, model.joint(model.actuator_trnid[k, 0]).name):
            return k
    raise UserError(f"no actuator {name!r} in this MuJoCo model")


class MujocoModel:
    """``substeps`` steps of MuJoCo under a constant control, without warm start."""

    name = "MuJoCo"

    def __init__(self, model: mujoco.MjModel, substeps: int) -> None:
        self.model, self.substeps = model, substeps
        self.dt = float(substeps * model.opt.timestep)
        self._data = mujoco.MjData(model)

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv), float64."""
        start = full_states(self.model, q.numpy(), v.numpy())
        control = np.repeat(u.numpy()[:, None], self.substeps, axis=1)
        # With a list of one MjData, rollout runs in the calling thread, so that its processor time is counted.
        state, _ = rollout.rollout(self.model, [self._data], start, control)
        nq, nv = self.model.nq, self.model.nv
        end = torch.from_numpy(state[:, -1, 1 : 1 + nq + nv].copy())
        return end[:, :nq], end[:, nq:]


def full_states(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """MuJoCo's state vectors (B, n): time zero, q (B, nq), v (B, nv). Raises UserError for a model with more state."""
    if mujoco.mj_stateSize(model, STATE) != 1 + model.nq + model.nv:
        raise UserError("this MuJoCo model has actuator or plugin states, which logs do not record")
    return np.hstack([np.zeros((len(q), 1)), q, v])
