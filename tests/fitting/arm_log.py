"""A position log of an arm in MuJoCo that follows slowly moving targets."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.data.position_log import PositionLog


def followed(xml: str, rows: int, **gains: float) -> PositionLog:
    """``rows`` at 100 Hz of the joints a and b of ``xml``, whose time step is 2 ms."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    positions, commands, target = [], [], np.zeros(2)
    for k in range(rows):
        if k % 60 == 0:
            goal = draw.uniform(-0.6, 0.6, 2)
        target = target + 0.07 * (goal - target)
        positions.append(data.qpos.copy())
        commands.append(target)
        data.ctrl[:] = target
        mujoco.mj_step(model, data, nstep=5)
    time, position, command = 0.01 * np.arange(rows), np.array(positions), np.array(commands)
    return PositionLog(time=time, position=position, command=command, joint_names=("a", "b"), **gains)
