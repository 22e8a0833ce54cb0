"""Positions under torques that hold nothing are compared over fewer steps than under servos that do."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of

ROD = """<mujoco><option timestep=".005"/><worldbody><body pos="0 0 1"><joint name="j" axis="0 1 0" damping=".002"/>
<geom type="capsule" size=".01" fromto="0 0 0 0 0 .06" mass=".3"/></body></worldbody><actuator>{}</actuator></mujoco>"""
MOTOR, SERVO = '<motor name="m" joint="j"/>', '<position name="m" joint="j" kp="1" kv=".02"/>'


def log_of(actuator: str, noise: float) -> PositionLog:
    """Eight seconds of a rod that stands on its end and sways: by a controller's torques, or by a servo."""
    model, draw = mujoco.MjModel.from_xml_string(ROD.format(actuator)), np.random.default_rng(0)
    data = mujoco.MjData(model)
    time = 0.005 * np.arange(1600)
    target, position, command = 0.3 * np.sin(3.0 * time) + 0.1 * np.sin(7.1 * time), np.zeros(1600), np.zeros(1600)
    for k in range(1600):
        position[k] = data.qpos[0]
        wanted = (target[k] - data.qpos[0]) - 0.02 * data.qvel[0]
        data.ctrl[0] = command[k] = wanted if actuator == MOTOR else target[k]
        mujoco.mj_step(model, data)
    position += noise * draw.normal(size=1600)
    return PositionLog(
        time=time,
        position=position[:, None],
        command=command[:, None],
        joint_names=("j",),
        command_kind="torque" if actuator == MOTOR else "position",
    )


@pytest.mark.parametrize(
    ("actuator", "noise", "least", "most"), [(SERVO, 1e-4, 100, 100), (MOTOR, 1e-4, 25, 50), (MOTOR, 1e-2, 25, 25)]
)
def test_what_commands_do_not_hold_is_compared_over_fewer_steps(
    actuator: str, noise: float, least: int, most: int
) -> None:
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(ROD.format(actuator)))
    (steps,) = horizons_of(Evidence.of(model, log_of(actuator, noise)), "auto")
    assert least <= steps <= most


SLAB = """<mujoco><option timestep=".005"/><worldbody><geom type="plane" size="0 0 1"/><body pos="0 0 .02"><freejoint/>
<geom type="box" size=".2 .2 .02" mass="5"/><body pos="0 0 .03"><joint name="j" axis="0 1 0" damping=".002" {}/>
<geom type="{}" mass=".3" contype="0" conaffinity="0"/></body></body></worldbody><actuator>{}</actuator></mujoco>"""
STICK, WHEEL = 'capsule" size=".01" fromto="0 0 0 0 0 .06', 'cylinder" size=".06 .01" zaxis="0 1 0'
DRIVE = '<velocity name="m" joint="j" kv=".02"/>'


@pytest.mark.parametrize(
    ("joint", "shape", "actuator", "expected"),
    [
        ("", WHEEL, DRIVE, 80),
        ("", STICK, MOTOR, 40),  # balanced: starts part faster than they drift
        ('range="-90 90"', STICK, MOTOR, 40),
        ("", STICK, SERVO, 40),
    ],
)
def test_a_body_on_wheels_is_compared_over_more_steps(joint: str, shape: str, actuator: str, expected: int) -> None:
    """A slab on the floor that bears a wheel, a stick that torques balance, or one that a servo holds."""
    text = SLAB.format(joint, shape, actuator)
    model, log = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(text)), log_of(MOTOR, 1e-4)
    log = replace(log, command_kind="position" if actuator == SERVO else "control")
    seen = np.tile([0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0], (1600, 1))
    seen[:, :3] += 1e-4 * np.random.default_rng(1).normal(size=(1600, 3))
    log = replace(log, base=seen)
    (steps,) = horizons_of(Evidence.of(model, log), "auto")
    assert steps == expected
