"""MuJoCo as a simulator of the bank: mj_step on the very MJCF, elliptic cones, Newton's method; and made stiff."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.bench.studies.stability.case import Case
from cmbrl.bench.studies.stability.simulators import start_state


@dataclass(frozen=True)
class MuJoCo:
    """At MuJoCo's own settings but for the step and the cone; restitution is what the MJCF's solref makes of it.

    ``stiff``: as hard as MuJoCo's contacts get, solref (2 h, 1), solimp .99 .9999, impratio 100, no matter what the
    MJCF says, but for contacts that are to bounce.
    """

    name: str = "MuJoCo"
    stiff: bool = False

    def start(self, case: Case, h: float) -> MuJoCoUnderWay:
        simulation = MuJoCoUnderWay(case, h)
        if self.stiff:
            simulation.stiffen()
        return simulation


class MuJoCoUnderWay:
    """``failures`` counts MuJoCo's own warnings of bad numbers."""

    def __init__(self, case: Case, h: float) -> None:
        self._model = mujoco.MjModel.from_xml_string(case.mjcf)
        self._model.opt.timestep = h
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:], self._data.qvel[:] = start_state(case)
        self._data.ctrl[:] = case.control

    def stiffen(self) -> None:
        """See :class:`MuJoCo`."""
        model = self._model
        model.opt.impratio = 100
        for reference, impedance in ((model.geom_solref, model.geom_solimp), (model.jnt_solref, model.jnt_solimp)):
            reference[reference[:, 0] > 0] = 2 * model.opt.timestep, 1
            impedance[:, :3] = 0.99, 0.9999, 1e-4

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
        handler = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda _: None)  # the default one leaves a log file in the working directory
        try:
            mujoco.mj_step(self._model, self._data, nstep=count)
        finally:
            mujoco.set_mju_user_warning(handler)
