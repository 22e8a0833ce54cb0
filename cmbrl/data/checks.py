"""Checks of a log on entry: it is well-formed, finite, and a log of the given robot.

Every check raises :class:`cmbrl.UserError` with one line that names the array, the row (from 0) and the remedy. What
the numbers of the log tell about faults of sensors and units is in :mod:`cmbrl.data.plausible`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.data import plausible
from cmbrl.data.fields import Fields
from cmbrl.errors import UserError
from cmbrl.numbers import names, real, real_array
from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

QUATERNION_TOLERANCE = (
    0.05  #: of the norm; simulators and filters drift by less, wrong orders or units miss by far more
)
TIME_STEP_TOLERANCE = 1e-3  #: relative; distinguishes 0.0068 s from 1/148 s
LARGEST = 1e12  #: far beyond any position, velocity, force or time of a robot; squares of sums are still finite
REGULAR = 0.5  #: largest deviation of a time step from the median, as a share of it


def numbers(name: str, value: Any) -> np.ndarray:
    """``value`` as contiguous float64 (rows, columns); raises for another type or shape, NaN, and beyond LARGEST."""
    array = real_array(value, name)
    if array.ndim != 2:
        raise UserError(f"{name} has shape {array.shape}; give two axes (rows, columns), even for one column")
    bad = ~(np.abs(array) <= LARGEST)
    if bad.any():
        if len(bad) > 1 and (empty := bad.all(axis=0)).any():
            raise UserError(
                f"no usable number in column {int(empty.argmax())} of {name}: record it, or leave the column out"
            )
        row, column = np.argwhere(bad)[0]
        x, rows = array[row, column], int(bad.any(axis=1).sum())
        kind = "NaN" if np.isnan(x) else "infinity" if np.isinf(x) else f"{x:g} (no robot is beyond {LARGEST:g})"
        more = f" ({rows} rows in all)" if rows > 1 else ""
        raise UserError(f"{kind} in row {row} of {name}, column {column}{more}: remove these rows or record again")
    return array


def stacked(q: Any, v: Any, u: Any, q_next: Any, v_next: Any) -> dict[str, np.ndarray]:
    """The five arrays as float64 (N, columns); raises if one is malformed or their shapes disagree."""
    given = (("q", q), ("v", v), ("u", u), ("q_next", q_next), ("v_next", v_next))
    arrays = {name: numbers(name, value) for name, value in given}
    rows = len(arrays["q"])
    for name, array in arrays.items():
        if len(array) != rows:
            raise UserError(f"{name} has {len(array)} rows, q has {rows}; give one row per transition")
    for name, like in (("q_next", "q"), ("v_next", "v")):
        if arrays[name].shape[1] != arrays[like].shape[1]:
            columns = arrays[name].shape[1], arrays[like].shape[1]
            raise UserError(f"{name} has {columns[0]} columns, {like} has {columns[1]}; both need the same")
    nq, nv = arrays["q"].shape[1], arrays["v"].shape[1]
    if nv > nq:
        raise UserError(f"v has more columns ({nv}) than q ({nq}); are they swapped?")
    return arrays


def duration(dt: Any) -> float:
    """``dt`` as a float [s]; raises unless it is one positive number, and neither it nor the rate is beyond LARGEST."""
    return real(dt, "dt, the duration of one transition in seconds,", least=1.0 / LARGEST, most=LARGEST)


def episodes(episode: Any, rows: int, name: str = "episode") -> np.ndarray:
    """Episode numbers (N,) as int64; raises unless every row has a whole number and each episode is one block."""
    array = real_array(episode, name)
    if array.shape != (rows,):
        raise UserError(f"{name} has shape {array.shape}; give one whole number for each of the {rows} rows")
    if not (np.abs(array) < 2**53).all() or (array != np.floor(array)).any():
        raise UserError(f"{name} contains values that are not whole numbers; number the {name}s 0, 1, 2, ...")
    numbers = array.astype(np.int64)
    starts = np.flatnonzero(np.diff(numbers)) + 1
    blocks = numbers[np.concatenate([[0], starts])] if rows else numbers
    seen, counts = np.unique(blocks, return_counts=True)
    if (counts > 1).any():
        torn = seen[counts > 1][0]
        raise UserError(f"{name} {torn} resumes after another one; keep its rows together, in time order")
    return numbers


def unique_names(given: Any, name: str, columns: int, of: str) -> tuple[str, ...]:
    """``given`` as names; raises unless there is one for each of the ``columns`` of array ``of``, and none twice."""
    found = names(given, name)
    if len(found) != columns:
        raise UserError(f"{name} has {len(found)} names for the {columns} columns of {of}; give one per column")
    if twice := next((one for one in found if found.count(one) > 1), None):
        raise UserError(f"{name} has {twice!r} twice; give every column a name of its own")
    return found


def poses(given: Any, rows: int) -> np.ndarray:
    """Poses (T, 7) with unit quaternions, of the two signs the one next to the last; raises for other shapes."""
    array = numbers("base", given)
    if array.shape != (rows, 7):
        raise UserError(f"base has shape {array.shape}; give a place and a quaternion w x y z for each of {rows} rows")
    norm = np.linalg.norm(array[:, 3:], axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > QUATERNION_TOLERANCE)
    if len(bad):
        raise UserError(
            f"quaternion in row {bad[0]} of base has norm {norm[bad[0]]:.4g}; give unit quaternions w x y z"
        )
    unit = array[:, 3:] / norm[:, None]
    sign = np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.hstack([array[:, :3], unit * np.cumprod(np.concatenate([[1.0], sign]))[:, None]])


def gains(given: Any, name: str, columns: int) -> np.ndarray | None:
    """One gain for each of ``columns`` commands, or None; raises unless they are finite and not negative."""
    if given is None:
        return None
    array = real_array(given, name)
    if array.shape not in ((), (1,), (columns,)):
        raise UserError(f"{name} has shape {array.shape}; give one gain, or one for each of the {columns} commands")
    if len(wrong := np.flatnonzero(~((array >= 0) & (array <= LARGEST)))):
        value, of = array.flat[wrong[0]], f" of command {wrong[0]}" * (array.size > 1)
        kind = "not known (NaN): leave the gain out" if np.isnan(value) else f"{value:g}: give a finite gain >= 0"
        raise UserError(f"{name}{of} is {kind}")
    return np.ascontiguousarray(np.broadcast_to(array, (columns,)))


def time_steps(time: np.ndarray, episode: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows that the same episode continues, and the time [s] from each to the next."""
    rows = np.flatnonzero(episode[1:] == episode[:-1])
    return rows, time[rows + 1] - time[rows]


def times(given: Any, episode: np.ndarray) -> np.ndarray:
    """``given`` as times (T,) [s]; raises unless it rises within each episode by nearly equal steps."""
    time = real_array(given, "time")
    if time.shape != (len(episode),):
        raise UserError(f"time has shape {time.shape}; give one time for each of the {len(episode)} rows")
    finite = np.abs(time) <= LARGEST
    if not finite.all():
        raise UserError(f"time in row {np.flatnonzero(~finite)[0]} is not a finite number; remove such rows")
    rows, steps = time_steps(time, episode)
    if not len(steps):
        raise UserError("the log has no two samples in one episode; record more")
    if (steps <= 0).any():
        row = rows[steps <= 0][0]
        raise UserError(f"time does not rise from row {row} to the next; sort the rows, or number the episodes")
    step = np.median(steps)
    uneven = np.abs(steps - step) > REGULAR * step
    if uneven.any():
        row, found = rows[uneven][0], steps[uneven][0]
        remedy = "resample the log by `cmbrl import`"
        raise UserError(f"time rises by {found:.4g} s after row {row}, elsewhere by {step:.4g} s: {remedy}")
    return time


def against_scene(log: Fields, scene: Scene, dt: float | None = None) -> None:
    """Raises unless ``log`` can be a log of ``scene``: sizes, names, quaternions, velocities, ``dt`` [s] if given."""
    if not hasattr(scene, "core"):
        raise UserError(f"scene is a {type(scene).__name__}; give the Scene of the robot")
    if len(log["q"]) == 0:
        raise UserError("the log is empty; record at least one transition")
    _check_sizes(log, scene)
    _check_names("joint", log["joint_names"], tuple(scene.joint_names), scene)
    _check_names("actuator", log["actuator_names"], tuple(scene.actuator_names), scene)
    _check_quaternions(log, scene)
    if dt is not None and abs(log["dt"] - dt) > TIME_STEP_TOLERANCE * dt:
        raise UserError(
            f"one transition of the log takes {log['dt']:.6g} s, one step of the model {dt:.6g} s; "
            "choose substeps and time step so that their product is the log's dt"
        )
    if not log["source"].get("positions"):  # whose log has been checked as it was
        plausible.check_transitions(log, scene)


def _check_sizes(log: Fields, scene: Scene) -> None:
    found = (log["q"].shape[1], log["v"].shape[1], log["u"].shape[1])
    wanted = (scene.nq, scene.nv, scene.nu)
    if found != wanted:
        remedy = "give the recorded scene, and raw qpos and qvel rather than observations"
        if scene.urdf_changes and (found[2] or found[1] == scene.nv + 6):
            base = " --floating --floor" if found[1] == scene.nv + 6 else ""
            remedy = (
                "a URDF tells neither actuators nor a floating base: make an MJCF of it by `cmbrl convert FILE.urdf "
                f"FILE.xml --actuators motor{base}` (or position --kp GAIN)"
            )
        raise UserError(f"log of another robot: (nq, nv, nu) is {found}, for scene {scene.name!r} {wanted}; {remedy}")


def _check_names(kind: str, found: tuple[str, ...], wanted: tuple[str, ...], scene: Scene) -> None:
    """Compares names only if all are known on both sides."""
    if not all(found) or not all(wanted) or not found or not wanted or found == wanted:
        return
    if sorted(found) == sorted(wanted):
        at = next(i for i, (a, b) in enumerate(zip(found, wanted, strict=True)) if a != b)
        raise UserError(
            f"{kind} order differs: {kind} {at} is {found[at]!r} in the log and {wanted[at]!r} in scene "
            f"{scene.name!r}; reorder the columns of the log"
        )
    unknown, place = sorted(set(found) - set(wanted)), f"in scene {scene.name!r}"
    if not unknown:
        unknown, place = sorted(set(wanted) - set(found)), "in the log"
    raise UserError(f"log of another robot: {kind} {unknown[0]!r} is missing {place}; give the recorded scene")


def _check_quaternions(log: Fields, scene: Scene) -> None:
    ball = scene.core.jnt_type == JointKind.BALL
    for address in scene.core.jnt_qadr[ball]:
        for name, array in (("q", log["q"]), ("q_next", log["q_next"])):
            norm = np.linalg.norm(array[:, address : address + 4], axis=1)
            bad = np.flatnonzero(np.abs(norm - 1.0) > QUATERNION_TOLERANCE)
            if len(bad):
                raise UserError(
                    f"quaternion in row {bad[0]} of {name} (columns {address} to {address + 3}) has norm "
                    f"{norm[bad[0]]:.4g}; give unit quaternions in the order w x y z"
                )


def unit_quaternions(q: np.ndarray, scene: Scene) -> np.ndarray:
    """``q`` (N, nq) with quaternions of norm 1."""
    unit = q.copy()
    for address in scene.core.jnt_qadr[scene.core.jnt_type == JointKind.BALL]:
        quaternion = unit[:, address : address + 4]
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return unit
