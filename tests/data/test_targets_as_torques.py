"""Targets that a log calls torques are told; torques that go with positions by weight or a spring are not refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.data.plausible import of_positions
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, faults, position_log, simulate, torque_log

PAIR = """<mujoco><option timestep="0.002"/><worldbody>
<body><joint name="a" axis="0 1 0" damping="1" {spring}/><geom size=".02" mass="{mass}" pos="0 0 -.5"/></body><body
pos="1 0 0"><joint name="b" axis="0 1 0" damping="1" {spring}/><geom size=".02" mass="{mass}" pos="0 0 -.5"/></body>
</worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""
TOLD = "say where the joints are a moment later"


def told(log: PositionLog, scene: Scene) -> list[bool]:
    return [found.sure for found in of_positions(log, scene) if TOLD in found.text]


def followed(folder: Path) -> PositionLog:
    """Fifteen seconds of an arm under servos that follows sines, whose targets are called torques."""
    time, draw = 0.005 * np.arange(3000), np.random.default_rng(0)
    command = 0.6 * np.sin(np.outer(time, draw.uniform(1.0, 2.5, 3)) + draw.uniform(0.0, 6.0, 3))
    place = simulate(arm_file(folder, True), command, noise=2e-4)[0]
    return PositionLog(time=time, position=place, command=command, joint_names=JOINTS, command_kind="torque")


def test_targets_logged_as_torques_are_refused(tmp_path: Path) -> None:
    log, motors = followed(tmp_path), Scene.from_mjcf(arm_file(tmp_path, False))
    assert told(log, motors) == [True]
    rests = replace(log, position=log.position * [1.0, 0.0, 0.0])
    assert told(rests, motors) == [False]  # one joint alone may be so by chance


@pytest.mark.parametrize("seed", range(4))
def test_targets_as_targets_and_torques_as_torques_are_not(tmp_path: Path, seed: int) -> None:
    servo, motor = arm_file(tmp_path, True), arm_file(tmp_path, False)
    assert told(position_log(servo, seed), Scene.from_mjcf(servo)) == []
    assert not any(TOLD in text for text in faults(torque_log(motor, seed), Scene.from_mjcf(motor)))


def slow_torques(xml: str) -> PositionLog:
    """Two joints so slow that their torques are what holds them, about 1 N m in each radian."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, time = mujoco.MjData(model), 0.01 * np.arange(6000)
    torque = 0.5 * np.sin(np.outer(time, [0.05, 0.08]))
    place = np.empty_like(torque)
    for k, each in enumerate(torque):
        place[k], data.ctrl[:] = data.qpos, each
        mujoco.mj_step(model, data, 5)
    return PositionLog(time=time, position=place, command=torque, joint_names=("a", "b"), command_kind="torque")


@pytest.mark.parametrize(("mass", "spring"), [(0.204, ""), (0.001, 'stiffness="1"')])
def test_torques_that_hold_weight_or_springs_are_at_most_warned_of(mass: float, spring: str) -> None:
    xml = PAIR.format(mass=mass, spring=spring)
    assert True not in told(slow_torques(xml), Scene.from_mjcf(xml))
