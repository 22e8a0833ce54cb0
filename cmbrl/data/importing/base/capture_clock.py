"""The clock of a motion capture: by which body, and by what was logged beside it, an import finds how late it is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cmbrl.data.importing.base import clock as base_clock
from cmbrl.data.importing.base import standing_clock
from cmbrl.data.importing.bodies import ANGULAR, Floating, joints_of
from cmbrl.data.importing.grid import Key, Series
from cmbrl.data.importing.velocities import check_frame
from cmbrl.errors import UserError
from cmbrl.scene import Scene

_JOINTS = "joints"  # what told the offset of the clocks
_CLEARLY = 3.0  # times its error: an offset that is one

Found = dict[Key, Series]


def told_offset(
    courses: Mapping[Floating, tuple[np.ndarray, np.ndarray]],
    robot: Found,
    scene: Scene,
    frame: str | None,
    where: str,
) -> tuple[float, str]:
    """How much later [s] the capture's clock is, by the body that tells it best; and a note."""
    found: list[tuple[base_clock.Offset, str]] = []
    failed: list[UserError] = []
    for body, (time, poses) in courses.items():
        gyro = gyroscope(robot, body)
        try:
            told = base_clock.offset(*_compared(time, poses, robot, gyro, frame, scene), where)
        except UserError as error:
            failed.append(error)
            continue
        witness = _witness(gyro, frame)
        closer = standing_clock.refined(robot, time, poses, body, scene, told) if witness == _JOINTS else None
        found.append((closer, "what stands on the floor") if closer is not None else (told, witness))
    if not found:
        raise failed[0]
    told, witness = min(found, key=lambda one: (not one[0].sure, one[0].error))
    if not told.sure:
        raise UserError(
            f"{where}: parts of the motion tell offsets {told.error:.2g} s apart: {base_clock.REMEDY}, or record "
            "more motion"
        )
    return told.seconds, f"clock of the base: {told.seconds:.4f} s later (+- {told.error:.2g} s), by base and {witness}"


def late(time: np.ndarray, poses: np.ndarray, robot: Found, scene: Scene, where: str) -> str:
    """What to do about stamps of one clock that are those of arrival, where the motion clearly says so."""
    try:
        found = base_clock.offset(*_compared(time, poses, robot, None, None, scene), where)
    except UserError:  # the motion does not tell
        return ""
    if not found.sure or not abs(found.seconds) > max(_CLEARLY * found.error, float(np.median(np.diff(time)))):
        return ""
    return (
        f"; their stamps are {found.seconds:.4f} s (+- {found.error:.2g} s) later than the joints', by base and "
        "joints: give the file by --base as well to take that out"
    )


def gyroscope(robot: Found, base: Floating) -> Series | None:
    """The logged angular velocity (T, 3) of a base, where there is one."""
    keys = [(base.name, name) for name in ANGULAR]
    if any(key not in robot for key in keys):
        return None
    first = robot[keys[0]]
    values = np.column_stack([np.interp(first.time, robot[key].time, robot[key].values[:, 0]) for key in keys])
    return Series(first.time, values)


def _witness(gyro: Series | None, frame: str | None) -> str:
    return "gyroscope" if gyro is not None and frame == "body" else _JOINTS


def _compared(
    time: np.ndarray, poses: np.ndarray, robot: Found, gyro: Series | None, frame: str | None, scene: Scene
) -> tuple[base_clock.Course, base_clock.Course, base_clock.Course]:
    """The motion of the base and what tells of it on the robot's clock, roughly and closely."""
    motion = base_clock.twist(time, poses)
    if gyro is not None and frame == "body":
        told = base_clock.Course(gyro.time, gyro.values)
        return base_clock.Course(time, motion.values[:, 3:]), told, told
    keys = [(joint.name, "position") for joint in joints_of(scene)[0]]
    singles = [robot[key] for key in keys if key in robot]  # others follow by ties and loops
    if not singles:
        raise UserError(
            "nothing but the base moves, so the offset of the clocks is open: log a gyroscope (base.wx to base.wz) and "
            "give --angular-velocity body, or give --base-offset SECONDS (0 if both have one clock)"
        )
    first = singles[0].time
    positions = np.column_stack([np.interp(first, one.time, one.values[:, 0]) for one in singles])
    return motion, *base_clock.rates(first, positions)


def check_gyroscope(base: Floating, gyro: Series, time: np.ndarray, poses: np.ndarray, frame: str | None) -> None:
    """Raises UserError unless the frame is told, and fits the rotation of the capture."""
    rows = (gyro.time >= time[0]) & (gyro.time <= time[-1])
    at = gyro.time[rows]
    told = base_clock.Course(time, base_clock.twist(time, poses).values[:, 3:]).at(at)
    near = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
    check_frame(base.name, "angular", frame, gyro.values[rows], told, poses[near, 3:])
