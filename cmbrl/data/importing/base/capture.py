"""The pose of a floating base from motion capture: another file, rate and clock than those of the joints."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from cmbrl.data.importing.base import capture_clock
from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, QUATERNION, TURN, Floating, joints_of
from cmbrl.data.importing.grid import Key, Series
from cmbrl.data.smoothing import smooth, smooth_rotations
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.manifold import rotate_by, rotation_between

ORDERS = ("wxyz", "xyzw")
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
    """All series of both on the robot's clock, with the poses at the joints' samples, and what was done.

    ``offset`` [s]: how much later the capture's clock is; None: found in the motion. ``frame``: of a gyroscope among
    the robot's series. Of several bodies, all poses are those of one clock. Raises UserError if a pose is not whole,
    the motion does not tell the offset, or a gyroscope is in another frame.
    """
    courses = {body: _course(body, capture) for body in _captured(capture, scene, where)}
    note = f"clock of the base: {offset:g} s later, as told" if offset is not None else ""
    if offset is None:
        offset, note = capture_clock.told_offset(courses, robot, scene, frame, where)
    moved = {key: Series(one.time - offset, one.values, one.kind) for key, one in capture.items()}
    found, notes = {**robot, **moved}, [note]
    for body, (late, poses) in courses.items():
        time, gyro = late - offset, capture_clock.gyroscope(robot, body)
        if gyro is not None:
            capture_clock.check_gyroscope(body, gyro, time, poses, frame)
        between, how = _at_joints(robot, time, poses, body, where)
        found |= between
        notes += [how] if how and how not in notes else []
    return found, "; ".join(notes)


def at_joints(robot: Found, scene: Scene, where: str) -> tuple[Found, str]:
    """The poses of floating bodies in ``robot``, on the same clock, at the joints' samples where they are slower; what
    was done.

    Nothing where they are as fast, or not there.
    """
    bodies = [joint for joint in joints_of(scene)[1] if joint.free]
    found: Found = {}
    notes: list[str] = []
    for body in bodies:
        if any(key not in robot for key in _keys(body)):
            continue
        time, poses = _course(body, robot)
        between, told = _at_joints(robot, time, poses, body, where)
        found |= between
        if told:
            told += capture_clock.late(time, poses, robot, scene, where) if len(bodies) == 1 else ""
            notes += [told] if told not in notes else []
    return found, "; ".join(notes)


def _keys(body: Floating) -> list[Key]:
    return [(body.name, name) for name in (*PLACE, QUATERNION)]


def _course(body: Floating, series: Found) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) [s] and poses (T, 7) of a body."""
    keys = _keys(body)
    time = series[keys[3]].time
    places = np.column_stack([np.interp(time, series[key].time, series[key].values[:, 0]) for key in keys[:3]])
    return time, np.hstack([places, series[keys[3]].values])


def _at_joints(robot: Found, time: np.ndarray, poses: np.ndarray, base: Floating, where: str) -> tuple[Found, str]:
    masters = [one for key, one in robot.items() if key[1] == "position"]
    if not masters or (own := np.median(np.diff(time))) <= SLOWER * (step := np.median(np.diff(masters[0].time))):
        return {}, ""
    told = f"poses every {own:.4g} s, smoothed, and read in between every {step:.4g} s"
    return _between(time, poses, masters[0].time, base, where), told


def _captured(capture: Found, scene: Scene, where: str) -> list[Floating]:
    """The floating bodies whose poses are in ``capture``; raises UserError where there is none, or a part is not."""
    free = [joint for joint in joints_of(scene)[1] if joint.free]
    if not free:
        raise UserError(f"scene {scene.name!r} has 0 free joints; the pose of a base is for one")
    bodies = [body for body in free if any(key in capture for key in _keys(body))] or free[:1]
    for body in bodies:
        if missing := [key for key in _keys(body) if key not in capture]:
            name = "base" if len(free) == 1 else body.name
            part = missing[0][1]
            raise UserError(f"{where}: no column for {body.name}.{part}: map one by --map COLUMN={name}.{part}")
    return bodies


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
