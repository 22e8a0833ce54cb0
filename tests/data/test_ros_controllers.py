"""Bags whose messages are not ROS's own, as drivers of real robots write them: ros2_control and Unitree."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log

pytest.importorskip("rosbags")
ROWS, DT, START = 300, 0.005, 1_700_000_000_000_000_000
CONTROLLER = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
"""
UNITREE = {  # as many fields as count here
    "unitree_go/msg/IMUState": "float32[4] quaternion\nfloat32[3] gyroscope\n",
    "unitree_go/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau_est\n",
    "unitree_go/msg/MotorCmd": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau\nfloat32 kp\nfloat32 kd\n",
    "unitree_go/msg/LowState": "unitree_go/IMUState imu_state\nunitree_go/MotorState[5] motor_state\nuint32 tick\n",
    "unitree_go/msg/LowCmd": "uint8[2] head\nunitree_go/MotorCmd[5] motor_cmd\n",
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    file = arm_file(tmp_path_factory.mktemp("arm"), servo=True)
    return SimpleNamespace(log=position_log(file, rows=ROWS), scene=Scene.from_mjcf(file))


def store_with(definitions: dict[str, str]) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in definitions.items():
        store.register(get_types_from_msg(text, name))
    return store


def write(folder: Path, store: Any, topics: dict[str, list[Any]], plugin: str = "MCAP") -> Path:
    from rosbags import rosbag2

    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin[plugin]) as writer:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, message in enumerate(messages):
                writer.write(connection, START + round(k * DT * 1e9), store.serialize_cdr(message, kind))
    return folder


def controller_states(arm: SimpleNamespace, store: Any) -> list[Any]:
    types = store.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    point, duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"](0, 0)
    empty = np.zeros(0)

    def at(positions: np.ndarray) -> Any:
        return point(positions, empty, empty, empty, duration)

    found = []
    for k in range(ROWS):
        now = START + round(k * DT * 1e9)
        aim, is_at = arm.log.command[k], arm.log.position[k]
        found.append(types["control_msgs/msg/JointTrajectoryControllerState"](
            header(stamp(now // 10**9, now % 10**9), ""), list(JOINTS), at(aim), at(is_at), at(aim - is_at), at(empty)
        ))  # fmt: skip
    return found


def same(log: Any, arm: SimpleNamespace, tolerance: float = 1e-9) -> None:
    assert isinstance(log, PositionLog)
    np.testing.assert_allclose(log.position, arm.log.position, atol=tolerance)
    np.testing.assert_allclose(log.command, arm.log.command, atol=tolerance)


def test_a_controller_tells_set_points_and_what_it_measured(arm: SimpleNamespace, tmp_path: Path) -> None:
    store = store_with({"control_msgs/msg/JointTrajectoryControllerState": CONTROLLER})
    states = controller_states(arm, store)
    same(import_logs([write(tmp_path / "bag", store, {"/arm/controller_state": states})], arm.scene).log, arm)
    kind = store.types["sensor_msgs/msg/JointState"]
    empty = np.zeros(0)
    measured = [kind(s.header, list(JOINTS), s.feedback.positions + 0.01, empty, empty) for s in states]
    both = {"/arm/controller_state": states, "/joint_states": measured}
    log = import_logs([write(tmp_path / "both", store, both)], arm.scene).log
    np.testing.assert_allclose(log.position, arm.log.position + 0.01, atol=1e-9)  # the joints' own topic counts


def low_level(arm: SimpleNamespace, store: Any, kp: np.ndarray, ahead: float = 0.0) -> dict[str, list[Any]]:
    types = store.types
    imu = types["unitree_go/msg/IMUState"](np.array([1, 0, 0, 0], "f4"), np.zeros(3, "f4"))
    state, command = types["unitree_go/msg/MotorState"], types["unitree_go/msg/MotorCmd"]
    states, commands, speed = [], [], np.gradient(arm.log.position, DT, axis=0)
    for k in range(ROWS):
        motors = [state(1, q, dq, 0.0) for q, dq in zip([*arm.log.position[k], 9, 9], [*speed[k], 0, 0], strict=True)]
        states.append(types["unitree_go/msg/LowState"](imu, motors, k))
        servos = [command(1, q, 0.0, ahead, kp[k], 2.0) for q in (*arm.log.command[k], 9.0, 9.0)]
        commands.append(types["unitree_go/msg/LowCmd"](np.zeros(2, "u1"), servos))
    return {"/lowstate": states, "/lowcmd": commands}


def test_a_unitree_robot(arm: SimpleNamespace, tmp_path: Path) -> None:
    store = store_with(UNITREE)
    bag = write(tmp_path / "bag", store, low_level(arm, store, np.full(ROWS, 40.0)))
    found = import_logs([bag], arm.scene, Options(joints=JOINTS))
    assert isinstance(found.log, PositionLog)
    assert found.log.kp is not None
    assert found.log.kd is not None
    same(found.log, arm, tolerance=1e-6)
    assert (found.log.kp.tolist(), found.log.kd.tolist()) == ([40.0] * 3, [2.0] * 3)
    assert not [note for note in found.notes if "torque (" in note]
    ahead = write(tmp_path / "ahead", store, low_level(arm, store, np.full(ROWS, 40.0), ahead=1.0))
    notes = import_logs([ahead], arm.scene, Options(joints=JOINTS)).notes
    assert [note for note in notes if note.startswith("not in the log") and "torque (" in note]


def test_gains_that_change_are_asked_for(arm: SimpleNamespace, tmp_path: Path) -> None:
    store = store_with(UNITREE)
    bag = write(tmp_path / "bag", store, low_level(arm, store, np.linspace(0, 40, ROWS)))
    with pytest.raises(UserError, match=r"kp of 'shoulder' changes: import a part where it holds, or give --kp"):
        import_logs([bag], arm.scene, Options(joints=JOINTS))
    log = import_logs([bag], arm.scene, Options(joints=JOINTS, kp=50.0)).log
    assert isinstance(log, PositionLog)
    assert log.kp is not None
    assert log.kp.tolist() == [50.0] * 3


def test_a_bag_that_does_not_define_its_types(
    arm: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = store_with(UNITREE)
    bag = write(tmp_path / "bag", store, low_level(arm, store, np.full(ROWS, 40.0)))
    monkeypatch.setattr("cmbrl.data.importing.readers.rosbag._defined", lambda reader, kind: False)
    with pytest.raises(UserError, match=r"/lowcmd \(unitree_go/msg/LowCmd\), .* does not define: convert it to MCAP"):
        import_logs([bag], arm.scene, Options(joints=JOINTS))
