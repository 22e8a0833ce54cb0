"""Position logs: what is accepted, what is written, and which scene they belong to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.estimation import estimated
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .conftest import scene_of


def make(rows: int = 20, **other: Any) -> PositionLog:
    rng = np.random.default_rng(0)
    given: dict[str, Any] = {
        "time": 0.005 * np.arange(rows),
        "position": rng.standard_normal((rows, 2)),
        "command": rng.standard_normal((rows, 2)),
        "joint_names": ("hip", "knee"),
    }
    return PositionLog(**{**given, **other})


@pytest.fixture(scope="module")
def leg(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A scene of two hinges with a motor each, the motors in the other order."""
    return scene_of(
        tmp_path_factory.mktemp("leg"),
        "leg",
        """<body><joint name="hip" axis="0 1 0"/><geom size=".1" mass="1"/>
        <body pos="0 0 -.3"><joint name="knee" axis="0 1 0"/><geom size=".1" mass="1"/></body></body>""",
        '<position name="m_knee" joint="knee" kp="20"/><position name="m_hip" joint="hip" kp="20"/>',
    )


@pytest.mark.parametrize(
    "other",
    [
        {},
        {"kp": 20.0, "kd": np.array([1.0, 2.0])},
        {"command_kind": "torque", "actuator_names": ("m_hip", "m_knee"), "episode": np.repeat([3, 5], 10)},
    ],
)
def test_what_is_written_is_read(tmp_path: Path, other: dict[str, Any]) -> None:
    log = make(**other)
    log.save(tmp_path / "a.npz")
    again = PositionLog.load(tmp_path / "a.npz")
    for name in ("time", "position", "command", "kp", "kd", "episode"):
        np.testing.assert_array_equal(getattr(again, name), getattr(log, name))
    assert (again.joint_names, again.actuator_names) == (log.joint_names, log.actuator_names)
    assert again.command_kind == log.command_kind
    assert again.dt == pytest.approx(0.005)


def test_the_scene_tells_coordinates_and_actuators(leg: Scene) -> None:
    log = make(joint_names=("knee", "hip"))
    log.check(leg)
    assert log.coordinates(leg).tolist() == [1, 0]
    assert log.actuators(leg).tolist() == [0, 1]  # the motors of the knee and of the hip
    named = make(actuator_names=("m_hip", "m_knee"))
    named.check(leg)
    assert named.actuators(leg).tolist() == [1, 0]


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"joint_names": ("hip", "kne")}, "joint 'kne' of the log is not in scene 'leg': did you mean 'knee'"),
        ({"actuator_names": ("m_hip", "pump")}, "actuator 'pump' of the log is not in scene"),
        (
            {"position": np.zeros((20, 1)), "command": np.zeros((20, 1)), "joint_names": ("hip",)},
            "joint 'knee' of scene 'leg' is not in the log",
        ),
        ({"command": np.zeros((20, 1)), "actuator_names": ("m_hip",)}, "actuator 'm_knee' of scene 'leg' has no"),
    ],
)
def test_a_log_of_another_robot(leg: Scene, other: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        make(**other).check(leg)


def test_joints_without_an_actuator() -> None:
    """A URDF has none; the error says what adds them."""
    bare = Scene.from_mjcf(
        '<mujoco model="bare"><worldbody><body><joint name="hip"/><geom size=".1"/><body pos="0 0 -1">'
        '<joint name="knee"/><geom size=".1"/></body></body></worldbody></mujoco>'
    )
    for kind, told in (("position", "position --kp GAIN"), ("torque", "motor")):
        with pytest.raises(UserError, match=rf"'hip' has a command .* no actuator .*--actuators {told}`"):
            make(command_kind=kind).check(bare)


def test_a_machine_without_actuators_needs_no_commands(tmp_path: Path, leg: Scene) -> None:
    bare = Scene.from_mjcf(
        '<mujoco><worldbody><body><joint name="hip"/><geom size=".1" pos="0 0 -.5"/><body pos="0 0 -1">'
        '<joint name="knee"/><geom size=".1" pos="0 0 -.5"/></body></body></worldbody></mujoco>'
    )
    make(command=np.zeros((20, 0))).save(tmp_path / "log.npz")
    log = PositionLog.load(tmp_path / "log.npz")
    assert log.command_names == ()
    assert estimated(log, bare).u.shape == (19, 0)
    with pytest.raises(UserError, match=r"has no command in the log; log it, or remove it from the file"):
        log.check(leg)


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"joint_names": ("hip",)}, "joint_names has 1 names for the 2 columns"),
        ({"joint_names": ("hip", "hip")}, "'hip' twice"),
        ({"command": np.zeros((20, 3))}, "3 columns for 2 joints; name its columns by actuator_names"),
        ({"command": np.zeros((19, 2))}, "19 rows, joint_position has 20"),
        ({"position": np.full((20, 2), np.nan)}, "no usable number in column 0 of joint_position: record it"),
        ({"time": np.zeros(20)}, "time does not rise from row 0"),
        ({"time": np.where(np.arange(20) > 9, 1.0, 0.0) + 0.005 * np.arange(20)}, "after row 9, elsewhere by 0.005 s"),
        ({"time": np.full(20, np.inf)}, "time in row 0 is not a finite number"),
        ({"kp": -1.0}, "kp is -1: give a finite gain"),
        ({"kd": np.ones(3)}, r"kd has shape \(3,\)"),
        ({"command_kind": "speed"}, "unknown kind of command 'speed'"),
        ({"episode": np.arange(20)}, "no two samples in one episode"),
    ],
)
def test_what_is_refused(other: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        make(**other)


def test_files_that_are_no_position_logs(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time=np.zeros(3), joint_position=np.zeros((3, 1)))
    with pytest.raises(UserError, match=r"a\.npz: no joint_names in the file"):
        PositionLog.load(tmp_path / "a.npz")
    with pytest.raises(UserError, match="no such file"):
        PositionLog.load(tmp_path / "b.npz")
    with pytest.raises(UserError, match=r"give NAME\.npz"):
        make().save(tmp_path / "c.csv")


def test_rows_and_episodes() -> None:
    log = make(episode=np.repeat([0, 1], 10), time=np.tile(0.005 * np.arange(10), 2))
    assert (len(log), log.n_episodes) == (20, 2)
    assert replace(log, episode=np.repeat([0, 1], 10)).dt == pytest.approx(0.005)
    half = log.select(slice(0, 10))
    assert half.n_episodes == 1
    np.testing.assert_array_equal(half.position, log.position[:10])
    with pytest.raises(UserError, match="time rises by"):
        log.select([0, 1, 2, 3, 6, 7, 8, 9])
