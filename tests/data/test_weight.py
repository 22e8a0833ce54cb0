"""Torques of a driver that compensates gravity: told, and the weight added where it is asked for."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.data.importing import Options, import_logs
from cmbrl.data.plausible import of_positions
from cmbrl.data.plausible.motion import of_positions as of_positions_motion
from cmbrl.data.plausible.weight import untold
from cmbrl.data.position_log import PositionLog
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.kinematics import holding_forces

ARM = """<mujoco><option timestep="0.002"/><default>
<joint axis="0 1 0" damping=".5" armature=".05" frictionloss="{rub}"/></default>
<worldbody><body pos="0 0 1"><joint name="turn" axis="0 0 1"/><geom size=".05" mass="1"/>
<body><joint name="lift"/><geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="{mass}"/>
<body pos=".4 0 0"><joint name="bend"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="{mass}"/>
</body></body></body></worldbody>
<actuator><motor joint="turn"/><motor joint="lift"/><motor joint="bend"/></actuator></mujoco>"""
NAMES = ("turn", "lift", "bend")


def record(mass: float, speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (T,), positions and torques (T, 3) of an arm that follows sines under PD and the weight of the file."""
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=mass, rub=0.2))
    file = Scene.from_mjcf(ARM.format(mass=2.0, rub=0.0)).core
    data, time, draw = mujoco.MjData(model), 0.01 * np.arange(1500), np.random.default_rng(0)
    tones = speed * draw.uniform(0.1, 0.6, size=(3, 3))
    position, torque = np.empty((len(time), 3)), np.empty((len(time), 3))
    for row, now in enumerate(time):
        target = 0.5 * np.sin(2 * np.pi * tones * now + tones).sum(axis=0)
        position[row] = data.qpos
        torque[row] = 60.0 * (target - data.qpos) - 6.0 * data.qvel + holding_forces(file, data.qpos)
        data.ctrl = torque[row]
        for _ in range(5):
            mujoco.mj_step(model, data)
    return time, position, torque


def warned(scene: Scene, time: np.ndarray, position: np.ndarray, torque: np.ndarray) -> bool:
    log = PositionLog(time=time, position=position, command=torque, joint_names=NAMES, command_kind="torque")
    found = [finding for finding in of_positions(log, scene) if "none of what the links weigh" in finding.text]
    assert not any(finding.sure for finding in found)
    return bool(found)


@pytest.mark.parametrize(("mass", "speed"), [(2.0, 1.0), (1.4, 2.0), (2.3, 0.5)])
def test_torques_without_the_weight_are_told(mass: float, speed: float) -> None:
    scene = Scene.from_mjcf(ARM.format(mass=2.0, rub=0.0))
    time, position, torque = record(mass, speed)
    assert not warned(scene, time, position, torque)
    assert warned(scene, time, position, torque - holding_forces(scene.core, position))


@pytest.mark.parametrize(("factor", "told"), [(1e-3, "multiplied by 1000"), (-1.0, "negated: check its sign")])
def test_torques_in_another_unit_or_of_another_sign_are_told_as_such(factor: float, told: str) -> None:
    scene = Scene.from_mjcf(ARM.format(mass=2.0, rub=0.0))
    time, position, torque = record(2.0, 0.5)
    log = PositionLog(time=time, position=position, command=factor * torque, joint_names=NAMES, command_kind="torque")
    found = [one.text for one in untold(of_positions_motion(log, scene), scene)]
    assert len(found) == 1
    assert f"torque holds what the links weigh by the file if it is {told}" in found[0]


def test_an_arm_that_swings_without_torques_is_none_of_them() -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=2.0, rub=0.0))
    data, draw, rows, torques = mujoco.MjData(model), np.random.default_rng(0), [], []
    for _ in range(1500):
        rows.append(data.qpos.copy())
        torques.append(draw.normal(size=3))
        data.ctrl = torques[-1]
        mujoco.mj_step(model, data, 5)
    assert not warned(
        Scene.from_mjcf(ARM.format(mass=2.0, rub=0.0)), 0.01 * np.arange(1500), *map(np.array, (rows, torques))
    )


def test_the_weight_is_added_on_request(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(mass=2.0, rub=0.0), encoding="utf-8")
    scene = Scene.from_mjcf(file)
    time, position, torque = record(2.0, 1.0)
    table = np.column_stack([time, position, torque - holding_forces(scene.core, position)])
    header = ",".join(["time", *NAMES, *(f"{name}_torque" for name in NAMES)])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=header, comments="")
    with pytest.warns(UserWarning, match="--gravity-compensated"):
        import_logs([tmp_path / "log.csv"], scene)
    for kind in ("positions", "transitions"):
        found = import_logs([tmp_path / "log.csv"], scene, Options(compensated=True, kind=kind))
        assert "weight of the links by the file was added to 3 torques" in " ".join(found.notes)
        command = found.log.command if isinstance(found.log, PositionLog) else found.log.u
        first = int(np.argmin(np.abs(torque[:, 1] - command[0, 1])))
        np.testing.assert_allclose(command, torque[first : first + len(command)], atol=1e-6)


def test_a_file_that_compensates_is_not_added_to(tmp_path: Path) -> None:
    text = ARM.format(mass=2.0, rub=0.0).replace('<body pos=".4 0 0">', '<body pos=".4 0 0" gravcomp="1">')
    time, position, torque = record(2.0, 1.0)
    header = ",".join(["time", *NAMES, *(f"{name}_torque" for name in NAMES)])
    np.savetxt(
        tmp_path / "log.csv", np.column_stack([time, position, torque]), delimiter=",", header=header, comments=""
    )
    with pytest.raises(UserError, match="would be held twice"):
        import_logs([tmp_path / "log.csv"], Scene.from_mjcf(text), Options(compensated=True))


def test_what_holds_an_arm_is_what_mujoco_says() -> None:
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=2.0, rub=0.0))
    data, core = mujoco.MjData(model), Scene.from_mjcf(ARM.format(mass=2.0, rub=0.0)).core
    for q in np.random.default_rng(0).normal(size=(3, 3)):
        data.qpos = q
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(holding_forces(core, q), data.qfrc_bias, atol=1e-12)
