"""Reader of ROS bags: folders of rosbag2, and single .mcap, .db3 and .bag files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.importing.recording import Recording, Table, need
from cmbrl.errors import UserError
from cmbrl.text import shortened

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
NONE = -1.0  #: the first covariance of an orientation that an IMU does not tell
LATE = 3600.0  #: [s] a header's stamp further away from the time of recording is no stamp


def read_rosbag(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """Each topic of a known type is a table: joints, trajectories, arrays of numbers, poses, odometry, IMU.

    Columns are called TOPIC.QUANTITY.JOINT; times are the headers' stamps, else those of recording.
    """
    highlevel = need("rosbags.highlevel", path)
    typesys = need("rosbags.typesys", path)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    samples: dict[str, list[tuple[float, dict[str, float]]]] = {}
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            known = [one for one in reader.connections if one.msgtype in READERS]
            for connection, nanoseconds, raw in reader.messages(connections=known) if known else ():
                message = reader.deserialize(raw, connection.msgtype)
                topic = connection.topic.strip("/").replace("/", ".")
                values = dict(READERS[connection.msgtype](message, joints))
                samples.setdefault(topic, []).append((_stamp(message, nanoseconds * 1e-9), values))
            topics = sorted(f"{one.topic} ({one.msgtype})" for one in reader.connections)
    except Exception as error:  # the library raises kinds of its own for each storage, and struct and database errors
        raise UserError(f"{path}: not readable as a ROS bag ({shortened(repr(error), 200)})") from None
    tables = tuple(_table(topic, rows) for topic, rows in samples.items() if len(rows) > 1)
    if not tables:
        told = ", ".join(sorted(READERS))
        raise UserError(f"{path}: no topic of a known type; it has {', '.join(topics) or 'none'}; known: {told}")
    return [Recording(str(path), tables)]


def _table(topic: str, rows: list[tuple[float, dict[str, float]]]) -> Table:
    names = list(dict.fromkeys(name for _, values in rows for name in values))
    columns = {f"{topic}.{name}": np.array([values.get(name, np.nan) for _, values in rows]) for name in names}
    return Table(columns, np.array([time for time, _ in rows]))


def _stamp(message: Any, recorded: float) -> float:
    """The time [s] in a message's header, or that of its recording."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return recorded
    told = stamp.sec + 1e-9 * stamp.nanosec
    return told if told > 0 and abs(told - recorded) < LATE else recorded


def _joint_state(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    for quantity in ("position", "velocity", "effort"):
        for name, value in zip(message.name, getattr(message, quantity), strict=False):
            yield f"{quantity}.{name}", float(value)


def _trajectory(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    """The first point: controllers stream one point at a time."""
    if message.points:
        for name, value in zip(message.joint_names, message.points[0].positions, strict=False):
            yield f"command.{name}", float(value)


def _numbers(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    names = joints if len(joints) == len(message.data) else [f"[{k}]" for k in range(len(message.data))]
    return ((f"data.{name}", float(value)) for name, value in zip(names, message.data, strict=True))


def _pose(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    return _placed(message.pose.position, message.pose.orientation)


def _covered(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    return _pose(message.pose, joints)


def _transform(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    return _placed(message.transform.translation, message.transform.rotation)


def _placed(place: Any, turn: Any) -> Iterator[tuple[str, float]]:
    return zip(POSE, (place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z), strict=True)


def _odometry(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    yield from _pose(message.pose, joints)
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    yield from zip(TWIST, (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z), strict=True)


def _imu(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    spin, turn = message.angular_velocity, message.orientation
    yield from zip(TWIST[3:], (spin.x, spin.y, spin.z), strict=True)
    if message.orientation_covariance[0] != NONE and any((turn.w, turn.x, turn.y, turn.z)):
        yield from zip(POSE[3:], (turn.w, turn.x, turn.y, turn.z), strict=True)


READERS = {
    "sensor_msgs/msg/JointState": _joint_state,
    "trajectory_msgs/msg/JointTrajectory": _trajectory,
    "std_msgs/msg/Float64MultiArray": _numbers,
    "std_msgs/msg/Float32MultiArray": _numbers,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _covered,
    "geometry_msgs/msg/TransformStamped": _transform,
    "nav_msgs/msg/Odometry": _odometry,
    "sensor_msgs/msg/Imu": _imu,
}
