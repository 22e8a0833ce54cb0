"""Motors that do nothing near 0, where the file's do."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.between.robots import Robots

from .servo_arm import QUICK

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


@pytest.mark.parametrize("dead", [0.12, 0.0])
def test_a_dead_zone_is_found_where_there_is_one(dead: float, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(2.0))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), recorded(dead), budget=QUICK)
    assert ("dead_zone" in [row["group"] for row in found.report["selection"] or []]) == bool(dead)
    for motor in ("left", "right"):
        own = found.parameters[f"dead_zone.{motor}"]
        assert own.value == pytest.approx(dead, abs=0.01)
    data = Evidence.of(found.model, recorded(dead, seed=1)).log
    ahead = simulate({"fit": found.model}, data, scene, data.dt * (1.0 + np.arange(len(data))), restart=1.0)
    assert ahead.mean("fit").mean() < 5e-3


def test_derivatives_and_processes_have_it() -> None:
    """Of controls in the dead zone, by differences; and step by step as along a log."""
    scene = cmbrl.Scene.from_mjcf(arm(2.5))
    values = {"dead_zone.left": 0.1, "dead_zone.right": 0.2, "delay.command": 0.013, "lag.command": 0.02}
    model = cmbrl.ComplementarityModel(scene, observation=values).for_log(DT)
    log = Evidence.of(model, recorded(0.1)).log.select(slice(0, 60))
    psi = model.observer.vector(model.observation)
    u, slope = model.observer.controls(log, psi)
    for name in ("dead_zone.left", "dead_zone.right"):
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


def test_a_command_of_0_still_has_a_gradient_where_no_zone_is_dead() -> None:
    """A policy that begins there could not learn else."""
    model = cmbrl.ComplementarityModel(
        cmbrl.Scene.from_mjcf(arm(2.5)), observation={"dead_zone.left": 0.1, "delay.command": 1e-3}
    ).for_log(DT)
    u = torch.zeros(1, 2, dtype=torch.float64, requires_grad=True)
    state = torch.zeros(1, 2, dtype=torch.float64)
    _, v = Robots(model, 1).step(state, state, u)
    (slope,) = torch.autograd.grad(v.square().sum() + v.sum(), u)
    assert slope[0, 0] == 0.0
    assert abs(slope[0, 1]) > 1e-3
