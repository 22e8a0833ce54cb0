"""MuJoCo as a simulator, with each of its integrators."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from mujoco import rollout

from cmbrl.bench.studies.simulators.engine import Path
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def integrators() -> dict[str, int]:
    """MuJoCo's integrators, as many as the installed version has, by lower-case name."""
    members = mujoco.mjtIntegrator.__members__.items()
    return {name.removeprefix("mjINT_").lower(): value for name, value in members}


class Mujoco:
    """One trajectory after the other in ``mujoco.rollout``, a loop in C over ``mj_step``."""

    family, limit, copies = "mujoco", "MuJoCo", 1

    def __init__(self, scene: TrajectoryScene, integrator: str) -> None:
        self.name = f"MuJoCo, {integrator}"
        assert scene.peer is not None
        self._scene, self._model = scene, copy.deepcopy(scene.peer)
        self._model.opt.integrator = integrators()[integrator]
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged state stays one
        self._data = mujoco.MjData(self._model)

    def run(self, steps: int) -> Path:
        s, model, data = self._scene, self._model, self._data
        model.opt.timestep = s.interval / steps
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        out = np.empty((len(s.q), s.u.shape[1], model.nq))
        handler = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda text: None)  # blow-ups are counted, not logged to a file
        try:
            for i in range(len(s.q)):
                mujoco.mj_resetData(model, data)
                data.qpos[:], data.qvel[:] = s.q[i], s.v[i]
                mujoco.mj_getState(model, data, state, _STATE)
                control = np.repeat(s.u[i], steps, axis=0)[None] if model.nu else None
                nstep = s.u.shape[1] * steps
                states, _ = rollout.rollout(model, data, state[None], control, nstep=nstep)
                out[i] = states[0, steps - 1 :: steps, 1 : 1 + model.nq]
        finally:
            mujoco.set_mju_user_warning(handler)
        return Path(out)
