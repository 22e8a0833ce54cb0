"""Two hanging links under motors, what encoders tell of them, and what any law of their motors has to agree in."""

from __future__ import annotations

import mujoco
import numpy as np
import torch

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.models.between.robots import Robots

DT, H, ROWS = 0.01, 0.002, 1000


def arm(mass: float) -> str:
    """The file of two hanging links under motors."""
    return f"""<mujoco><option timestep="{H}" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" armature=".05" damping=".4"/>
<geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="{mass}"/><body pos="0 0 -.4">
<joint name="b" axis="0 1 0" armature=".02" damping=".1"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass=".5"/></body></body></worldbody>
<actuator><motor name="left" joint="a" gear="4" ctrlrange="-1 1"/>
<motor name="right" joint="b" gear="1.5" ctrlrange="-1 1"/></actuator></mujoco>"""


def recorded(dead: float, seed: int = 0) -> PositionLog:
    """What encoders tell of motors that do nothing within ``dead`` of 0, and of a heavier link."""
    model = mujoco.MjModel.from_xml_string(arm(2.5))
    data, time, rng = mujoco.MjData(model), DT * np.arange(ROWS), np.random.default_rng(seed)
    rates, phases = rng.uniform(1.0, 9.0, (2, 3)), rng.uniform(0.0, 6.3, (2, 3))
    command = 0.25 * np.sin(time[:, None, None] * rates + phases).sum(axis=2)
    places = []
    for u in command:
        places.append(data.qpos.copy())
        data.ctrl[:] = u - np.clip(u, -dead, dead)
        for _ in range(round(DT / H)):
            mujoco.mj_step(model, data)
    position = np.array(places) + 1e-4 * rng.standard_normal((ROWS, 2))
    return PositionLog(time=time, position=position, command=command, joint_names=("a", "b"), command_kind="control")


def check_controls(model: cmbrl.ComplementarityModel, log: Transitions, names: tuple[str, ...]) -> None:
    """Slopes of controls in the parameters ``names`` are differences, and a process has the controls of the log."""
    psi = model.observer.vector(model.observation)
    u, slope = model.observer.controls(log, psi)
    for name in names:
        k = [p.name for p in model.observer.parameters].index(name)
        up, down = (model.observer.commands(log, psi + x * np.eye(len(psi))[k]) for x in (1e-7, -1e-7))
        assert np.abs((up - down) / 2e-7 - slope[:, :, k]).max() < 1e-6
        assert slope[:, :, k].any()
    robots, seen = Robots(model, 1), []
    step = robots._model_step
    robots._model_step = lambda q, v, u, *more: seen.append(u.numpy()[0]) or step(q, v, u, *more)  # type: ignore[func-returns-value]
    q, v = torch.from_numpy(log.q[:1]), torch.from_numpy(log.v[:1])
    for command in torch.from_numpy(log.u):
        q, v = robots.step(q, v, command[None])
    assert np.abs(np.array(seen) - u).max() < 1e-9
