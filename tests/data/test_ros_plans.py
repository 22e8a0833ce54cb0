"""Bags with plans of several points, numbers by joint, frames, and nodes that share a topic."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.importing import import_logs
from cmbrl.data.importing.base.capture import mapping_of
from cmbrl.data.importing.readers.trajectories import STEP, Plan, followed
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log
from .test_ros_controllers import DT, ROWS, START, store_with, write

pytest.importorskip("rosbags")
DYNAMIC = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/DynamicJointState": (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    ),
    "own_msgs/msg/Gripper": "float64 width\n",
}
EMPTY = np.zeros(0)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    file = arm_file(tmp_path_factory.mktemp("arm"), servo=True)
    return SimpleNamespace(log=position_log(file, rows=ROWS), scene=Scene.from_mjcf(file))


def header(store: Any, k: int, frame: str = "") -> Any:
    now = START + round(k * DT * 1e9)
    stamp = store.types["builtin_interfaces/msg/Time"](now // 10**9, now % 10**9)
    return store.types["std_msgs/msg/Header"](stamp, frame)


def states(arm: SimpleNamespace, store: Any, names: tuple[str, ...] = JOINTS) -> list[Any]:
    kind, columns = store.types["sensor_msgs/msg/JointState"], [JOINTS.index(name) for name in names]
    rows = np.ascontiguousarray(arm.log.position[:, columns])
    return [kind(header(store, k), list(names), rows[k], EMPTY, EMPTY) for k in range(ROWS)]


def test_a_plan_is_followed_from_point_to_point(arm: SimpleNamespace, tmp_path: Path) -> None:
    store = store_with({})
    types = store.types
    point, duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
    every = 10
    ahead = [duration(*divmod(round(k * DT * 1e9), 10**9)) for k in range(0, ROWS, every)]
    aims = np.sin(np.arange(ROWS) / 60.0)[:, None] * [0.3, 0.5, 0.2]
    points = [point(x, EMPTY, EMPTY, EMPTY, at) for x, at in zip(aims[::every], ahead, strict=True)]
    plan = types["trajectory_msgs/msg/JointTrajectory"](header(store, 0), list(JOINTS), points)
    told = states(SimpleNamespace(log=SimpleNamespace(position=aims)), store)
    bag = write(tmp_path / "bag", store, {"/joint_states": told, "/arm/joint_trajectory": [plan]})
    log = import_logs([bag], arm.scene).log
    assert isinstance(log, PositionLog)
    rows = np.arange(len(log))
    last = (ROWS - 1) // every * every
    wanted = [np.interp(np.minimum(rows, last), np.arange(0, ROWS, every), x[::every]) for x in aims.T]
    np.testing.assert_allclose(log.command, np.transpose(wanted), atol=0.01)  # half a step later
    assert len(np.unique(log.command, axis=0)) > 0.9 * last


def test_the_next_plan_ends_one_and_goes_on_from_its_target() -> None:
    still = np.zeros((2, 1))
    first = Plan(0.0, ("j",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), None)
    second = Plan(0.5, ("j",), np.array([1.5, 2.0]), np.array([[2.0], [2.0]]), None)
    told = list(followed([first, second]))
    times = np.array([time for time, _ in told])
    values = np.array([row["j"] for _, row in told])
    assert (np.diff(times) > 0.0).all()
    assert np.diff(times).max() < 2 * STEP
    np.testing.assert_allclose(np.interp([0.25, 1.0, 1.5, 2.0], times, values), [0.25, 1.25, 2.0, 2.0], atol=5e-3)
    smooth = Plan(0.0, ("j",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), still)
    np.testing.assert_allclose(smooth.at(np.array([0.25, 0.5, 2.0]))[:, 0], [0.15625, 0.5, 1.0])  # 3 s^2 - 2 s^3


def test_numbers_by_joint_and_all_interfaces(arm: SimpleNamespace, tmp_path: Path) -> None:
    store = store_with(DYNAMIC)
    number, value = store.types["std_msgs/msg/Float64"], store.types["control_msgs/msg/InterfaceValue"]
    kind = store.types["control_msgs/msg/DynamicJointState"]
    topics = {
        f"/{name}_position_controller/command": [number(x) for x in arm.log.command[:, k].tolist()]
        for k, name in enumerate(JOINTS)
    }
    topics["/dynamic_joint_states"] = [
        kind(header(store, k), list(JOINTS), [value(["position"], np.array([x])) for x in arm.log.position[k]])
        for k in range(ROWS)
    ]
    log = import_logs([write(tmp_path / "bag", store, topics)], arm.scene).log
    assert isinstance(log, PositionLog)
    np.testing.assert_allclose(log.position, arm.log.position, atol=1e-9)
    np.testing.assert_allclose(log.command, arm.log.command, atol=1e-9)


def test_nodes_that_share_a_topic_lose_no_samples(arm: SimpleNamespace, tmp_path: Path) -> None:
    """An arm and its gripper publish joint states on one topic."""
    store = store_with(DYNAMIC)
    shared = [
        one for pair in zip(states(arm, store, JOINTS[:2]), states(arm, store, JOINTS[2:]), strict=True) for one in pair
    ]
    kind = store.types["sensor_msgs/msg/JointState"]
    aims = [kind(header(store, k), list(JOINTS), arm.log.command[k], EMPTY, EMPTY) for k in range(ROWS)]
    found = import_logs([write(tmp_path / "bag", store, {"/joint_states": shared, "/joint_commands": aims})], arm.scene)
    assert isinstance(found.log, PositionLog)
    np.testing.assert_allclose(found.log.position, arm.log.position, atol=1e-9)
    assert not any("no numbers" in note for note in found.notes)


def test_topics_that_are_not_read_are_named_where_a_joint_lacks(arm: SimpleNamespace, tmp_path: Path) -> None:
    store = store_with(DYNAMIC)
    topics = {
        "/joint_states": states(arm, store, JOINTS[:2]),
        "/gripper": [store.types["own_msgs/msg/Gripper"](0.1)] * ROWS,
        "/rosout_agg": [store.types["own_msgs/msg/Gripper"](0.1)] * 2,
    }
    told = r"no column for wrist.position.*; topics of types that are not read: /gripper \(own_msgs/msg/Gripper\)$"
    with pytest.raises(UserError, match=told):
        import_logs([write(tmp_path / "bag", store, topics)], arm.scene)


def test_frames_are_poses_where_no_topic_of_its_own_tells_one(arm: SimpleNamespace, tmp_path: Path) -> None:
    file = tmp_path / "box.xml"
    file.write_text(
        '<mujoco><worldbody><body name="box"><freejoint name="box"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    store = store_with({"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n"})
    types = store.types
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    height = 1.0 - 0.5 * 9.81 * (DT * np.arange(60)) ** 2
    frames = [
        types["geometry_msgs/msg/TransformStamped"](
            header(store, k, "world"), "vicon/marker", types["geometry_msgs/msg/Transform"](vector(0.0, 0.0, z), turn)
        )
        for k, z in enumerate(height.tolist())
    ]
    message = types["tf2_msgs/msg/TFMessage"]
    bag = write(tmp_path / "bag", store, {"/tf": [message([frame]) for frame in frames]})
    log = import_logs([bag], Scene.from_mjcf(file)).log
    assert not isinstance(log, PositionLog)
    np.testing.assert_allclose(log.q[:, 2], height[2 : 2 + len(log)], atol=1e-9)
    columns = [f"{head}.{x}" for head in ("tf.link_1", "mocap.box") for x in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    assert set(mapping_of(columns, {}, None, "bag")) == {name for name in columns if name.startswith("mocap")}
