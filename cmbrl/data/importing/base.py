"""The pose of a floating base from motion capture: another file, rate and clock than those of the joints."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from cmbrl.data.importing import base_clock, standing_clock
from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, QUATERNION, TURN, Floating, joints_of
from cmbrl.data.importing.grid import Key, Series
from cmbrl.data.importing.velocities import check_frame
from cmbrl.data.smoothing import smooth, smooth_rotations
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.manifold import rotate_by, rotation_between

ORDERS = ("wxyz", "xyzw")
_JOINTS = "joints"  # what told the offset of the clocks
_CLEARLY = 3.0  # times its error: an offset that is one
SLOWER = 1.2  # times the joints' time step: from there on the pose is smoothed before it is read in between
_ARRAY = re.compile(r"(?P<name>.*)\[(?P<number>\d)\]")
_TURNS, _PLACES = ("quat", "orient", "rotation"), ("pos", "translation", "xyz")
_POSES, _TWISTS = ("pose",), ("root_vel", "base_vel", "twist")  # seven and six columns

Found = dict[Key, Series]


def mapping_of(columns: Iterable[str], given: Mapping[str, str], order: str | None, where: str) -> dict[str, str]:
    """Targets of the unnamed columns of arrays of places, quaternions (which tell no order), poses and twists.

    So are those of the only pose, as of a topic with a name of its own. Raises UserError for a quaternion without
    ``order``.
    """
    columns = list(columns)
    arrays: dict[str, dict[int, str]] = {}
    for column in columns:
        if (match := _ARRAY.fullmatch(column)) and column not in given:
            arrays.setdefault(match["name"], {})[int(match["number"])] = column
    found: dict[str, str] = {}
    for name, parts in arrays.items():
        word = name.lower()
        size = len(parts) if set(parts) == set(range(len(parts))) else 0
        pose = size == 7 and any(part in word for part in _POSES)
        if pose or (size == 4 and any(part in word for part in _TURNS)):
            if order is None:
                raise UserError(
                    f"{where}: the {'last ' if pose else ''}four columns of {name!r} may be w x y z or x y z w, and "
                    "norms are alike: give --quaternion wxyz or xyzw (ROS and SciPy write xyzw, MuJoCo wxyz)"
                )
            turns = [f"base.q{letter}" for letter in order]
            found |= {parts[k]: word for k, word in enumerate([f"base.{x}" for x in PLACE if pose] + turns)}
        elif size == 3 and any(part in word for part in _PLACES):
            found |= {parts[k]: f"base.{letter}" for k, letter in enumerate(PLACE)}
        elif size == 6 and any(part in word for part in _TWISTS):
            found |= {parts[k]: f"base.{letter}" for k, letter in enumerate((*LINEAR, *ANGULAR))}
    return found or _only_pose(columns, given)


def _only_pose(columns: Iterable[str], given: Mapping[str, str]) -> dict[str, str]:
    """Targets of the columns NAME.x to NAME.qz, where there is one such NAME and none of them was ``given``.

    Frames of /tf, among which are all links of a robot, count where no topic of its own tells a pose.
    """
    heads: dict[str, set[str]] = {}
    for column in columns:
        head, _, last = column.rpartition(".")
        heads.setdefault(head, set()).add(last)
    poses = [head for head, parts in heads.items() if parts >= {*PLACE, *TURN}]
    poses = [head for head in poses if "tf" not in head.split(".")[:-1]] or poses
    if len(poses) != 1 or not poses[0] or any(word.partition(".")[2] in (*PLACE, *TURN) for word in given.values()):
        return {}
    return {f"{poses[0]}.{x}": f"base.{x}" for x in (*PLACE, *TURN) if f"{poses[0]}.{x}" not in given}


def synchronised(
    robot: Found, capture: Found, scene: Scene, offset: float | None, frame: str | None, where: str
) -> tuple[Found, str]:
    """All series of both on the robot's clock, with the pose at the joints' samples, and what was done.

    ``offset`` [s]: how much later the capture's clock is; None: found in the motion. ``frame``: of a gyroscope among
    the robot's series. Raises UserError if the motion does not tell the offset, or a gyroscope is in another frame.
    """
    base = _only_base(scene)
    keys = [*((base.name, name) for name in PLACE), (base.name, QUATERNION)]
    if missing := [key for key in keys if key not in capture]:
        raise UserError(
            f"{where}: no column for {base.name}.{missing[0][1]}: map one by --map COLUMN=base.{missing[0][1]}"
        )
    time = capture[base.name, QUATERNION].time
    places = np.column_stack([np.interp(time, capture[key].time, capture[key].values[:, 0]) for key in keys[:3]])
    poses = np.hstack([places, capture[base.name, QUATERNION].values])
    note = f"clock of the base: {offset:g} s later, as told" if offset is not None else ""
    gyro = _gyroscope(robot, base)
    if offset is None:
        told = base_clock.offset(*_compared(time, poses, robot, gyro, frame, scene), where)
        witness = _witness(gyro, frame)
        closer = standing_clock.refined(robot, time, poses, base, scene, told) if witness == _JOINTS else None
        if closer is not None:
            told, witness = closer, "what stands on the floor"
        if not told.sure:
            raise UserError(
                f"{where}: parts of the motion tell offsets {told.error:.2g} s apart: {base_clock.REMEDY}, or record "
                "more motion"
            )
        offset = told.seconds
        note = f"clock of the base: {offset:.4f} s later (+- {told.error:.2g} s), by base and {witness}"
    time = time - offset
    if gyro is not None:
        _check_gyroscope(base, gyro, time, poses, frame)
    moved = {key: Series(one.time - offset, one.values, one.kind) for key, one in capture.items()}
    between, how = _at_joints(robot, time, poses, base, where)
    return {**robot, **moved, **between}, "; ".join(filter(None, [note, how]))


def at_joints(robot: Found, scene: Scene, where: str) -> tuple[Found, str]:
    """The pose of the base in ``robot``, on the same clock, at the joints' samples where it is slower; what was done.

    Nothing where it is as fast, or not there.
    """
    floating = [joint for joint in joints_of(scene)[1] if joint.free]
    keys = [(base.name, name) for base in floating[:1] for name in (*PLACE, QUATERNION)]
    if len(floating) != 1 or any(key not in robot for key in keys):
        return {}, ""
    time = robot[keys[3]].time
    places = np.column_stack([np.interp(time, robot[key].time, robot[key].values[:, 0]) for key in keys[:3]])
    poses = np.hstack([places, robot[keys[3]].values])
    between, told = _at_joints(robot, time, poses, floating[0], where)
    return between, told + _late(time, poses, robot, scene, where) if told else ""


def _late(time: np.ndarray, poses: np.ndarray, robot: Found, scene: Scene, where: str) -> str:
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


def _at_joints(robot: Found, time: np.ndarray, poses: np.ndarray, base: Floating, where: str) -> tuple[Found, str]:
    masters = [one for key, one in robot.items() if key[1] == "position"]
    if not masters or (own := np.median(np.diff(time))) <= SLOWER * (step := np.median(np.diff(masters[0].time))):
        return {}, ""
    told = f"poses every {own:.4g} s, smoothed, and read in between every {step:.4g} s"
    return _between(time, poses, masters[0].time, base, where), told


def _only_base(scene: Scene) -> Floating:
    floating = [joint for joint in joints_of(scene)[1] if joint.free]
    if len(floating) != 1:
        raise UserError(f"scene {scene.name!r} has {len(floating)} free joints; the pose of a base is for one")
    return floating[0]


def _gyroscope(robot: Found, base: Floating) -> Series | None:
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


def _check_gyroscope(base: Floating, gyro: Series, time: np.ndarray, poses: np.ndarray, frame: str | None) -> None:
    """Raises UserError unless the frame is told, and fits the rotation of the capture."""
    rows = (gyro.time >= time[0]) & (gyro.time <= time[-1])
    at = gyro.time[rows]
    told = base_clock.Course(time, base_clock.twist(time, poses).values[:, 3:]).at(at)
    near = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
    check_frame(base.name, "angular", frame, gyro.values[rows], told, poses[near, 3:])


def _between(time: np.ndarray, poses: np.ndarray, wanted: np.ndarray, base: Floating, where: str) -> Found:
    """The smoothed pose at those of the ``wanted`` times that lie between samples, by cubic Hermite pieces."""
    dt, one = float(np.median(np.diff(time))), np.zeros(len(time), dtype=np.int64)
    place, turn = smooth(poses[:, :3], dt, one), smooth_rotations(poses[:, 3:], dt, one)
    wanted = wanted[(wanted >= time[0]) & (wanted <= time[-1])]
    if not len(wanted):
        raise UserError(
            f"{where}: on the robot's clock the capture lasts from {time[0]:.6g} to {time[-1]:.6g} s, and no joint was "
            "logged then: give another --base-offset"
        )
    b = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    a, width = b - 1, (time[b] - time[b - 1])[:, None]
    inside = width[:, 0] < 3.0 * dt  # a hole stays a hole
    a, b, width, wanted = a[inside], b[inside], width[inside], wanted[inside]
    s = (wanted - time[a])[:, None] / width
    from_a, to_b = s**3 - 2.0 * s**2 + s, s**3 - s**2
    whole = 3.0 * s**2 - 2.0 * s**3
    places = (1.0 - whole) * place.value[a] + whole * place.value[b]
    places += width * (from_a * place.rate[a] + to_b * place.rate[b])
    step = whole * rotation_between(turn.value[a], turn.value[b])
    step += width * (from_a * turn.rate[a] + to_b * turn.rate[b])
    found: Found = {(base.name, name): Series(wanted, places[:, k : k + 1]) for k, name in enumerate(PLACE)}
    return found | {(base.name, QUATERNION): Series(wanted, rotate_by(turn.value[a], step), "turn")}
