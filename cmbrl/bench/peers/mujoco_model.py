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
from cmbrl.scene.source.mjcf import name_of

GROUPS = (
    *("mass", "com_x", "com_y", "com_z", "damping", "armature", "stiffness", "frictionloss"),
    *("friction", "gear", "kp", "kd", "gravity"),
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
    motors = [name_of(model, "actuator", k) for k in range(len(model.actuator_trntype))]
    for name, value in values.items():
        group, _, of = name.partition(".")
        if group not in GROUPS:
            raise UserError(f"a compiled MuJoCo model has no parameter {name!r}; choose from {', '.join(GROUPS)}")
        if group == "mass":
            model.body(of).mass *= value
            model.body(of).inertia *= value
        elif group.startswith("com_"):
            model.body(of).ipos["xyz".index(group[-1])] += value
        elif group == "friction":
            model.geom(of).friction[0] = value
        elif group == "gear":
            model.actuator_gear[motors.index(of)] *= value
        elif group == "kp":
            k = motors.index(of)
            share = -value / model.actuator_biasprm[k, 1]
            model.actuator_gainprm[k, 0] *= share
            model.actuator_biasprm[k, :2] *= share
        elif group == "kd":
            model.actuator_biasprm[motors.index(of), 2] = -value
        elif group == "gravity":
            model.opt.gravity[:] *= value
        else:  # of a joint's degrees of freedom
            getattr(model.joint(of), group)[:] = value
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


class MujocoModel:
    """``substeps`` steps of MuJoCo under a constant control, without warm start.

    Raises UserError for a model whose state is more than time, q and v.
    """

    name = "MuJoCo"

    def __init__(self, model: mujoco.MjModel, substeps: int) -> None:
        if mujoco.mj_stateSize(model, STATE) != 1 + model.nq + model.nv:
            raise UserError("this MuJoCo model has actuator or plugin states, which logs do not record")
        self.model, self.substeps = model, substeps
        self.dt = float(substeps * model.opt.timestep)
        self._data = mujoco.MjData(model)

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv), float64."""
        start = np.hstack([np.zeros((len(q), 1)), q.numpy(), v.numpy()])
        control = np.repeat(u.numpy()[:, None], self.substeps, axis=1)
        # With a list of one MjData, rollout runs in the calling thread, so that its processor time is counted.
        state, _ = rollout.rollout(self.model, [self._data], start, control)
        nq, nv = self.model.nq, self.model.nv
        end = torch.from_numpy(state[:, -1, 1 : 1 + nq + nv].copy())
        return end[:, :nq], end[:, nq:]
