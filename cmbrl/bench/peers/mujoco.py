"""MuJoCo, with each of its integrators, at its own contact settings or with contacts as stiff as it allows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from cmbrl.bench.peers.simulator import Array, Simulator, World
from cmbrl.scene.source.robot_source import quiet as quiet

INTEGRATORS: dict[str, int] = {
    name.removeprefix("mjINT_").lower(): int(value) for name, value in mujoco.mjtIntegrator.__members__.items()
}  #: "euler", "rk4", ...: all that the installed version has
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_BAD = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


def compiled(mjcf: str | Path, integrator: str | None = None) -> mujoco.MjModel:
    """A new model of an MJCF text or file, with another integrator of :data:`INTEGRATORS` where one is given.

    A string that starts with "<" is an MJCF text, any other a path.
    """
    with quiet():
        text = isinstance(mjcf, str) and mjcf.lstrip().startswith("<")
        load = mujoco.MjModel.from_xml_string if text else mujoco.MjModel.from_xml_path
        model = load(str(mjcf))
    if integrator is not None:
        model.opt.integrator = INTEGRATORS[integrator]
    return model


class MuJoCo(Simulator):
    """``mj_step`` at the settings of the MJCF. Contacts bounce only as far as its solref makes them.

    integrator: default the MJCF's own.
    stiff: solref (2 h, 1), solimp .99 .9999 and impratio 100 instead of the MJCF's, except for contacts whose solref
        is a stiffness and a damping: these are meant to bounce.
    """

    def __init__(self, world: World, integrator: str | None = None, stiff: bool = False) -> None:
        self._model, self._stiff = compiled(world.mjcf, integrator), stiff
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged state stays one
        self._data = mujoco.MjData(self._model)

    def start(self, h: float, q: Array, v: Array) -> None:
        self._model.opt.timestep = h
        if self._stiff:
            self._stiffen()
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = q, v
        self.failures = 0

    def step(self, control: Sequence[float] | Array, count: int) -> None:
        self._data.ctrl[:] = control
        with quiet():
            mujoco.mj_step(self._model, self._data, nstep=count)
        self.failures = sum(int(self._data.warning[kind].number) for kind in _BAD)

    def state(self) -> tuple[Array, Array]:
        return np.array(self._data.qpos), np.array(self._data.qvel)

    def trajectories(self, q: Array, v: Array, u: Array, h: float, steps: int) -> tuple[Array, int]:
        """One after the other in ``mujoco.rollout``, a loop in C over ``mj_step``; failures are not counted."""
        model, data, intervals = self._model, self._data, u.shape[1]
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        out = np.empty((len(q), intervals, model.nq))
        with quiet():
            for i in range(len(q)):
                self.start(h, q[i], v[i])
                mujoco.mj_getState(model, data, state, _STATE)
                control = np.repeat(u[i], steps, axis=0)[None] if model.nu else None
                states, _ = rollout.rollout(model, data, state[None], control, nstep=intervals * steps)
                out[i] = states[0, steps - 1 :: steps, 1 : 1 + model.nq]
        return out, 0

    def _stiffen(self) -> None:
        model = self._model
        model.opt.impratio = 100
        for reference, impedance in ((model.geom_solref, model.geom_solimp), (model.jnt_solref, model.jnt_solimp)):
            reference[reference[:, 0] > 0] = 2 * model.opt.timestep, 1
            impedance[:, :3] = 0.99, 0.9999, 1e-4
