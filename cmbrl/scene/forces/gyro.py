"""Coriolis, centrifugal and gyroscopic forces that MuJoCo takes implicitly, as it takes damping."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import integers

_FREE = mujoco.mjtJoint.mjJNT_FREE
_LOAD = "<body pos='3 0 0'><geom type='box' size='2 1 1'/></body>"


def gyro_arrays(model: mujoco.MjModel) -> dict[str, Any]:
    """The dofs with such forces, for the core: all under "implicit", those of lone free bodies under "implicitfast"."""
    found = np.zeros(model.nv, dtype=bool)
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICIT:
        found[:] = True
    elif model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        for joint in np.flatnonzero(model.jnt_type == _FREE):
            found[model.jnt_dofadr[joint] + np.arange(6)] = _lone(model, int(model.jnt_bodyid[joint]))
    return {"ngyro": int(found.sum()), "gyro_dof": integers(found)}


def _lone(model: mujoco.MjModel, body: int) -> bool:
    """Whether no joint moves what a free body carries, and this MuJoCo takes such a body for a lone one."""
    if np.count_nonzero(model.body_rootid[model.dof_bodyid] == body) != 6:
        return False
    return _apart(bool(model.body_subtreemass[body] != model.body_mass[body]))


@lru_cache(maxsize=2)
def _apart(welded: bool) -> bool:
    """Whether this MuJoCo takes a free body under "implicitfast" as under "implicit"; found by trying.

    It does so since 3.11 (its documentation, "Gyroscopic derivatives"), and later also if mass is welded to the body.
    """
    rates = []
    for integrator in ("implicit", "implicitfast"):
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><option integrator='{integrator}'/><worldbody><body><freejoint/><geom type='box' size='1 2 3'/>"
            f"{_LOAD * welded}</body></worldbody></mujoco>"
        )
        data = mujoco.MjData(model)
        data.qvel[3:] = 1.0, 2.0, 3.0
        mujoco.mj_step(model, data)
        rates.append(data.qvel[3:].copy())
    return bool(np.abs(rates[0] - rates[1]).max() < 1e-9)
