"""MuJoCo as a simulator of the bank: mj_step on the very MJCF, elliptic cones, Newton's method."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.bench.stability.case import Case
from cmbrl.bench.stability.simulators import start_state


class MuJoCo:
    """At MuJoCo's own settings but for the step and the cone; restitution is what the MJCF's solref makes of it."""

    name = "MuJoCo"

    def start(self, case: Case, h: float) -> MuJoCoUnderWay:
        return MuJoCoUnderWay(case, h)


class MuJoCoUnderWay:
    """``failures`` counts MuJoCo's own warnings of bad numbers."""

    def __init__(self, case: Case, h: float) -> None:
        self._model = mujoco.MjModel.from_xml_string(case.mjcf)
        self._model.opt.timestep = h
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:], self._data.qvel[:] = start_state(case)
        self._data.ctrl[:] = case.control

    @property
    def q(self) -> np.ndarray:
        return np.array(self._data.qpos)

    @property
    def v(self) -> np.ndarray:
        return np.array(self._data.qvel)

    @property
    def failures(self) -> int:
        bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
        return sum(int(self._data.warning[kind].number) for kind in bad)

    def step(self, count: int) -> None:
        mujoco.mj_step(self._model, self._data, nstep=count)
