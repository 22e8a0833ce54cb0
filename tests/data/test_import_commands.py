"""Commands that an import finds: of tendons, and of motors that got targets, whose gains are told joint by joint."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cmbrl.cli.main import main
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.position_log import PositionLog
from cmbrl.errors import UserError
from cmbrl.scene import Scene


def _link(place: int, joint: str) -> str:
    turn = f'<joint name="{joint}" axis="0 1 0" range="-2 2"/>'
    return f'<body pos="{place} 0 0">{turn}<geom size=".1" pos="0 0 -1"/></body>'


def _robot(folder: Path, joints: tuple[str, ...], rest: str) -> Path:
    file = folder / "robot.xml"
    links = "".join(_link(place, joint) for place, joint in enumerate(joints))
    file.write_text(f"<mujoco><worldbody>{links}</worldbody>{rest}</mujoco>")
    return file


def test_commands_of_actuators_that_pull_tendons_make_a_position_log(tmp_path: Path) -> None:
    tendon = '<tendon><fixed name="cord"><joint joint="knuckle" coef="2"/></fixed></tendon>'
    servos = '<position name="pull" tendon="cord" kp="5"/><position name="turn" joint="wrist" kp="5"/>'
    file = _robot(tmp_path, ("knuckle", "wrist"), f"{tendon}<actuator>{servos}</actuator>")
    t = 0.01 * np.arange(40.0)
    columns = {"t": t, "wrist_pos": np.sin(9 * t), "knuckle_pos": t, "wrist_cmd": 2 * t, "pull_cmd": 3 * t}
    np.savez(tmp_path / "log.npz", **columns)
    log = import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file)).log
    assert isinstance(log, PositionLog)
    assert log.command_names == ("pull", "turn")
    np.testing.assert_allclose(log.command, np.column_stack([3 * t, 2 * t]))


def test_gains_by_joint_over_a_file_of_motors_and_servos(tmp_path: Path) -> None:
    motors = '<motor name="a" joint="lift"/><motor name="b" joint="turn"/>'
    servo = '<position name="c" joint="grip" kp="9" kv=".5" gear="2"/>'
    file = _robot(tmp_path, ("lift", "turn", "grip"), f"<actuator>{motors}{servo}</actuator>")
    t = 0.01 * np.arange(40.0)
    columns = {f"{joint}_{what}": np.sin(t) for joint in ("lift", "turn", "grip") for what in ("pos", "cmd")}
    np.savez(tmp_path / "log.npz", t=t, **columns)
    command = ["import", str(tmp_path / "log.npz"), "--scene", str(file), "--out", str(tmp_path / "out.npz")]
    assert main([*command, "--kp", "lift=40", "--kp", "turn=30", "--kd", "lift=2"]) == 0
    log = PositionLog.load(tmp_path / "out.npz")
    np.testing.assert_allclose(log.kp, [40.0, 30.0, 36.0])
    np.testing.assert_allclose(log.kd, [2.0, 0.0, 2.0])


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([], "'lift' .* is a motor, which takes a torque; give the gains"),
        (["--kp", "turn=3"], "no kp for 'lift', which is a motor in the file: give --kp lift=X"),
        (["--kp", "lifd=3"], "no command of 'lifd' in the log: did you mean 'lift'"),
        (["--kp", "lift=soft"], "--kp: 'soft' is not a finite number"),
    ],
)
def test_gains_that_lack(options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(
        f"<mujoco><worldbody>{_link(0, 'lift')}{_link(1, 'turn')}</worldbody>"
        '<actuator><motor name="lift" joint="lift"/><motor name="turn" joint="turn"/></actuator></mujoco>'
    )
    t = 0.01 * np.arange(40.0)
    columns = {f"{joint}_{what}": np.sin(t) for joint in ("lift", "turn") for what in ("pos", "cmd")}
    np.savez(tmp_path / "log.npz", t=t, **columns)
    out = tmp_path / "out.npz"
    assert main(["import", str(tmp_path / "log.npz"), "--scene", str(file), "--out", str(out), *options]) == 2
    assert re.search(told, capsys.readouterr().err)
    assert not out.exists()


_URDF = """<robot name="arm"><link name="base"/><link name="upper"><inertial><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="9" velocity="9"/></joint></robot>"""


def test_torques_over_a_urdf_without_motors_are_not_dropped_in_silence(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(_URDF)
    t = 0.01 * np.arange(40.0)
    np.savez(tmp_path / "log.npz", t=t, lift_pos=np.sin(t), tau_lift=np.cos(t))
    scene = Scene.from_mjcf(tmp_path / "arm.urdf")
    with pytest.raises(UserError, match=r"tells lift.torque.* no actuators: .*--actuators motor`, or leave"):
        import_logs([tmp_path / "log.npz"], scene)
    left = Options(columns={"tau_lift": "-"})
    assert import_logs([tmp_path / "log.npz"], scene, left).log.command.shape[1] == 0  # type: ignore[union-attr]


def test_a_machine_without_actuators_has_a_position_log_too(tmp_path: Path) -> None:
    file = _robot(tmp_path, ("upper", "lower"), "")
    t = 0.01 * np.arange(40.0)
    np.savez(tmp_path / "log.npz", t=t, upper=np.sin(9 * t), lower=np.cos(9 * t))
    log = import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file), Options(kind="positions")).log
    assert isinstance(log, PositionLog)
    assert log.command.shape == (40, 0)


def test_torques_of_a_joint_without_a_motor_are_said_to_be_left_out(tmp_path: Path) -> None:
    file = _robot(tmp_path, ("lift", "caster"), '<actuator><motor name="a" joint="lift"/></actuator>')
    t = 0.01 * np.arange(40.0)
    columns = {f"{joint}_{what}": np.sin(t) for joint in ("lift", "caster") for what in ("pos", "torque")}
    np.savez(tmp_path / "log.npz", t=t, **columns)
    notes = import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file)).notes
    assert "commands of caster are left out: no actuator of the file takes them" in notes
    assert "not used: caster_torque" in notes
    assert not [note for note in notes if note.startswith("not in the log")]


def test_what_the_log_has_no_place_for_is_named(tmp_path: Path) -> None:
    file = _robot(tmp_path, ("lift",), '<actuator><position name="a" joint="lift" kp="9"/></actuator>')
    t = 0.01 * np.arange(40.0)
    columns = {"lift_pos": np.sin(t), "lift_vel": np.cos(t), "lift_cmd": np.sin(t), "lift_torque": np.cos(t)}
    np.savez(tmp_path / "log.npz", t=t, **columns)
    for kind, left in (
        ("positions", "velocity (lift_vel), torque (lift_torque)"),
        ("transitions", "torque (lift_torque)"),
    ):
        notes = import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file), Options(kind=kind)).notes
        assert [note for note in notes if note.startswith(f"not in the log: {left}: ")]
        assert "position: lift_pos = lift.position" in notes
        assert not [note for note in notes if note.startswith("torque")]
        assert ("velocity: lift_vel = lift.velocity" in notes) == (kind == "transitions")


def test_commands_of_servos_of_velocities_are_velocities(tmp_path: Path) -> None:
    """Beside a position servo: all are controls, and rpm is a unit of such a command."""
    wheels = '<velocity name="a" joint="wheel" kv="2"/><velocity name="b" joint="other" kv="2" gear="3"/>'
    servo = '<position name="c" joint="lift" kp="9" kv=".5"/>'
    file = _robot(tmp_path, ("wheel", "other", "lift"), f"<actuator>{wheels}{servo}</actuator>")
    t = 0.01 * np.arange(40.0)
    columns = {"wheel_vel_cmd": t, "m2": 2 * t, "lift_cmd": 3 * t, "lift": np.sin(t)}
    columns |= {"wheel": np.sin(5 * t), "other": np.cos(t)}
    np.savez(tmp_path / "log.npz", t=t, **columns)
    options = Options(columns={"m2": "other.command:rpm"})
    log = import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file), options).log
    assert isinstance(log, PositionLog)
    assert log.command_kind == "control"
    np.testing.assert_allclose(log.command, np.column_stack([t, 6 * t * np.pi / 30, 3 * t]))


def test_commanded_velocities_in_a_log_with_velocities(tmp_path: Path) -> None:
    file = _robot(tmp_path, ("wheel",), '<actuator><velocity name="a" joint="wheel" kv="2" gear="3"/></actuator>')
    t = 0.01 * np.arange(40.0)
    columns = {"wheel": np.sin(5 * t), "wheel_vel": 5 * np.cos(5 * t), "wheel_vel_cmd": 2 * t}
    np.savez(tmp_path / "log.npz", t=t, **columns)
    log = import_logs([tmp_path / "log.npz"], Scene.from_mjcf(file)).log
    np.testing.assert_allclose(log.u[:, 0], 6 * t[:-1])  # type: ignore[union-attr]
