"""What motion without contact must keep, by MuJoCo's kinematics of the same MJCF."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.bench.studies.stability.case import Array, Case
from cmbrl.bench.studies.stability.simulators import compiled


def energy(case: Case, q: Array, v: Array) -> Array:
    """Kinetic and potential energy (n,) [J] of states (n, nq), (n, nv), by MuJoCo's kinematics."""
    model = compiled(case.mjcf)
    data = mujoco.MjData(model)
    out = np.empty(len(q))
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        out[k] = data.energy.sum()
    return out


def momentum(case: Case, q: Array, v: Array) -> tuple[Array, Array]:
    """Linear (n, 3) [N s] and, about the centre of mass, angular momentum (n, 3) [N m s] of all bodies."""
    model = compiled(case.mjcf)
    data = mujoco.MjData(model)
    linear, angular = np.empty((len(q), 3)), np.empty((len(q), 3))
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        linear[k] = model.body_subtreemass[0] * data.subtree_linvel[0]
        angular[k] = data.subtree_angmom[0]
    return linear, angular
