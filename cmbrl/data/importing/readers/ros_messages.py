"""What `cmbrl import` reads in ROS messages: numbers by name, type by type.

Every reader takes a message and the names in ``--joints``, and yields (QUANTITY.JOINT, number). Messages of transforms
(``FRAMES``), each of whose frames has a time of its own, are read by ``frames``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
FRAMES, PLANS = "tf2_msgs/msg/TFMessage", "trajectory_msgs/msg/JointTrajectory"
NONE = -1.0  #: the first covariance of an orientation that an IMU does not tell


def _joint_state(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    for quantity in ("position", "velocity", "effort"):
        for name, value in zip(message.name, getattr(message, quantity), strict=False):
            yield f"{quantity}.{name}", float(value)


def _trajectory(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    """The only point of a controller's stream; ``trajectories`` follows plans of several."""
    if message.points:
        for name, value in zip(message.joint_names, message.points[0].positions, strict=False):
            yield f"command.{name}", float(value)


def _dynamic(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    """All interfaces of ros2_control's joint_state_broadcaster, joint by joint."""
    for name, own in zip(message.joint_names, message.interface_values, strict=False):
        for quantity, value in zip(own.interface_names, own.values, strict=False):
            yield f"{quantity}.{name}", float(value)


def _number(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    yield "data", float(message.data)


def _controller(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    """Set points, and what a controller of ros2_control measured, which counts where no other topic tells it."""
    aims = [getattr(message, name, None) for name in ("reference", "desired")]  # the second is that of older releases
    found = [getattr(message, name, None) for name in ("feedback", "actual")]
    for head, points, quantity in (("command", aims, "positions"), ("feedback.position", found, "positions"),
                                   ("feedback.velocity", found, "velocities")):  # fmt: skip
        values: Iterable[float] = next((x for point in points if len(x := getattr(point, quantity, ()))), ())
        for name, value in zip(message.joint_names, values, strict=False):
            yield f"{head}.{name}", float(value)


def _low_state(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    """Motors and IMU of a Unitree robot."""
    yield from _motors("motor_state", message.motor_state, ("q", "dq"), joints)
    yield from zip((f"imu.{x}" for x in POSE[3:]), map(float, message.imu_state.quaternion), strict=True)
    yield from zip((f"imu.{x}" for x in TWIST[3:]), map(float, message.imu_state.gyroscope), strict=True)


def _low_command(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    """Targets and gains of the servos of a Unitree robot, and torques ahead of them."""
    yield from _motors("motor_cmd", message.motor_cmd, ("q", "kp", "kd", "tau"), joints)


def _motors(
    head: str, motors: Iterable[Any], quantities: Iterable[str], joints: tuple[str, ...]
) -> Iterator[tuple[str, float]]:
    """``joints`` name the first of the motors; messages have places for more than a robot has."""
    for k, motor in enumerate(motors):
        if not joints or k < len(joints):
            for quantity in quantities:
                name = f".{joints[k]}" if joints else f"[{k}]"
                yield f"{head}.{quantity}{name}", float(getattr(motor, quantity))


def _numbers(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    count = len(message.data)
    names = [f".{name}" for name in joints] if len(joints) == count else [f"[{k}]" for k in range(count)]
    return ((f"data{name}", float(value)) for name, value in zip(names, message.data, strict=True))


def _pose(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    return _placed(message.pose.position, message.pose.orientation)


def _covered(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    return _pose(message.pose, joints)


def _transform(message: Any, joints: tuple[str, ...]) -> Iterator[tuple[str, float]]:
    return _placed(message.transform.translation, message.transform.rotation)


def frames(message: Any) -> Iterator[tuple[Any, Iterator[tuple[str, float]]]]:
    """Each transform of a message of /tf, and its numbers by the name of the frame."""
    for one in message.transforms:
        frame = one.child_frame_id.strip("/").replace("/", ".")
        yield one, ((f"{frame}.{name}", value) for name, value in _transform(one, ()))


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
    PLANS: _trajectory,
    "control_msgs/msg/DynamicJointState": _dynamic,
    "std_msgs/msg/Float64": _number,
    "std_msgs/msg/Float32": _number,
    "std_msgs/msg/Float64MultiArray": _numbers,
    "std_msgs/msg/Float32MultiArray": _numbers,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _covered,
    "geometry_msgs/msg/TransformStamped": _transform,
    "nav_msgs/msg/Odometry": _odometry,
    "sensor_msgs/msg/Imu": _imu,
    "control_msgs/msg/JointTrajectoryControllerState": _controller,
    "unitree_go/msg/LowState": _low_state,
    "unitree_go/msg/LowCmd": _low_command,
    "unitree_hg/msg/LowState": _low_state,
    "unitree_hg/msg/LowCmd": _low_command,
}
