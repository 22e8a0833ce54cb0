"""What `cmbrl import` is told of whole arrays, as simulators' recorders write them: many, without names of columns."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.importing.base.capture import mapping_of
from cmbrl.data.importing.columns.whole_arrays import by_column
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log

STATES = "states.articulation.robot"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A file with the same joints twice: as they are, and as an observation, which is relative and reversed."""
    folder = tmp_path_factory.mktemp("recorded")
    robot = arm_file(folder, servo=True)
    log = position_log(robot, rows=300)
    arrays = {f"{STATES}.joint_position": np.degrees(log.position), "obs.joint_pos": log.position[:, ::-1] - 1.0,
              "actions": np.degrees(log.command)}  # fmt: skip
    np.savez(folder / "log.npz", time=0.005 * np.arange(300), **arrays)
    return SimpleNamespace(file=folder / "log.npz", log=log, scene=Scene.from_mjcf(robot))


def brought(recorded: SimpleNamespace, **columns: str) -> PositionLog:
    log = import_logs([recorded.file], recorded.scene, Options(columns=columns)).log
    assert isinstance(log, PositionLog)
    return log


def test_an_array_is_told_at_once(recorded: SimpleNamespace) -> None:
    log = brought(recorded, **{f"{STATES}.joint_position": "position:deg", "actions": "command:deg", "obs": "-"})
    np.testing.assert_allclose(log.position, recorded.log.position, atol=1e-9)
    np.testing.assert_allclose(log.command, recorded.log.command, atol=1e-9)
    assert log.joint_names == JOINTS


def test_what_is_told_of_a_column_counts_more(recorded: SimpleNamespace) -> None:
    given = {f"{STATES}.joint_position": "position:deg", "actions": "command:deg", "obs": "-"}
    moved = brought(recorded, **given, **{f"{STATES}.joint_position[1]": "elbow.position:deg+9"})
    np.testing.assert_allclose(moved.position[:, 1], recorded.log.position[:, 1] + np.radians(9), atol=1e-9)
    np.testing.assert_allclose(moved.position[:, 2], recorded.log.position[:, 2], atol=1e-9)


def test_columns_that_have_names_are_told_by_them(recorded: SimpleNamespace, tmp_path: Path) -> None:
    names = ("wrist", "elbow", "shoulder")
    np.savez(
        tmp_path / "named.npz", time=0.005 * np.arange(300), joint_names=np.array(names),
        aim=recorded.log.command[:, ::-1], joint_position=recorded.log.position[:, ::-1],
    )  # fmt: skip
    log = import_logs([tmp_path / "named.npz"], recorded.scene, Options(columns={"aim": "command"})).log
    assert isinstance(log, PositionLog)
    np.testing.assert_allclose(log.command, recorded.log.command, atol=1e-9)


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ({}, r"no column for shoulder.position: .* as --map states.articulation.robot.joint_position=position"),
        ({"obs": "pos"}, r"'obs' is an array: say - or which quantity"),
        ({STATES: "position", "obs": "velocity", "actions": "joint"}, r"'actions' is an array"),
        ({"obs": "-", STATES: "position", "acton": "-"}, r"no column 'acton' in the log"),
        ({"obs": "position", STATES: "position"}, r"two columns have the same target"),
    ],
)
def test_one_line_says_what_to_do(columns: dict[str, str], told: str, recorded: SimpleNamespace) -> None:
    with pytest.raises(UserError, match=told):
        brought(recorded, **columns)


def test_an_array_of_another_width(recorded: SimpleNamespace, tmp_path: Path) -> None:
    np.savez(tmp_path / "two.npz", time=0.005 * np.arange(300), q=recorded.log.position[:, :2])
    with pytest.raises(UserError, match=r"'q' has 2 columns and the robot 3 joints: name its columns by --joints"):
        import_logs([tmp_path / "two.npz"], recorded.scene, Options(columns={"q": "position"}))


def test_two_arrays_with_the_joints_names(recorded: SimpleNamespace) -> None:
    with pytest.raises(UserError, match=r"both look like .*; drop one by --map \S+=- or --map obs.joint_pos=-, or"):
        import_logs([recorded.file], recorded.scene, Options(joints=JOINTS))


def test_poses_and_twists_of_a_root() -> None:
    pose, twist = [f"robot.root_pose[{k}]" for k in range(7)], [f"robot.root_velocity[{k}]" for k in range(6)]
    found = mapping_of([*pose, *twist], {}, "xyzw", "log")
    assert [found[x] for x in pose] == [f"base.{x}" for x in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    assert [found[x] for x in twist] == [f"base.{x}" for x in ("vx", "vy", "vz", "wx", "wy", "wz")]
    with pytest.raises(UserError, match=r"last four columns of 'robot.root_pose' .* give --quaternion"):
        mapping_of(pose, {}, None, "log")
    assert mapping_of(pose, dict.fromkeys(pose, "-"), None, "log") == {}


def test_numbered_columns_between_spaces(recorded: SimpleNamespace, tmp_path: Path) -> None:
    """As clients of UR's RTDE and numpy.savetxt write them."""
    log = recorded.log
    table = np.column_stack([0.005 * np.arange(300), log.command, log.position, np.zeros((300, 6))])
    names = [f"{head}_{k}" for head in ("target_q", "actual_q", "target_moment", "actual_TCP_pose") for k in range(3)]
    np.savetxt(tmp_path / "savetxt.txt", table, header=" ".join(["timestamp", *names]))
    np.savetxt(tmp_path / "rtde.csv", table, header=" ".join(["timestamp", *names]), comments="")
    options = (Options(joints=JOINTS), Options(columns={"target_q": "command", "actual_q": "position"}))
    for file in ("savetxt.txt", "rtde.csv"):
        for told in options:
            found = import_logs([tmp_path / file], recorded.scene, told).log
            assert isinstance(found, PositionLog)
            np.testing.assert_allclose(found.position, log.position, atol=1e-9)
            np.testing.assert_allclose(found.command, log.command, atol=1e-9)


def test_an_array_of_the_driven_joints_alone() -> None:
    """A gripper whose second finger follows the first: a command for the first alone."""
    scene = Scene.from_mjcf(
        """<mujoco><worldbody><body><joint name="turn" axis="0 0 1"/><geom size=".1"/>
        <body><joint name="left" type="slide"/><geom size=".01" pos=".2 0 0"/></body>
        <body><joint name="right" type="slide"/><geom size=".01" pos=".3 0 0"/></body></body></worldbody>
        <equality><joint joint1="right" joint2="left" polycoef="0 -1 0 0 0"/></equality>
        <actuator><position joint="turn" kp="9"/><position joint="left" kp="9"/></actuator></mujoco>"""
    )
    columns = ["actions[0]", "actions[1]"]
    told = {"actions[0]": "turn.command", "actions[1]": "left.command"}
    assert by_column({"actions": "command"}, columns, scene) == told
    with pytest.raises(UserError, match="has 1 column and the robot 3 joints"):
        by_column({"actions": "command"}, columns[:1], scene)
