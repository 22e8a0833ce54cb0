"""Checks at the door: what enters as a log is well-formed, finite, and of the robot that it is said to be of.

Every check raises :class:`cmbrl.UserError` with one line that names the array, the row (counted from 0) and the remedy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

QUATERNION_TOLERANCE = 1e-3  #: on the norm; motion capture rounds to about 1e-6, other orders or units miss by far more
TIME_STEP_TOLERANCE = 1e-3  #: relative; tells 0.0068 s from 1/148 s
ROWS_FOR_KINEMATICS = 50  #: fewer rows do not tell whether velocities and positions belong together
SENSOR_NOISE = 1e-4  #: changes of this size [m, rad] may be noise, which velocities do not explain
UNEXPLAINED = 0.95  #: a log is refused when velocities leave more of a change unexplained (share, root mean square)


def numbers(name: str, value: Any) -> np.ndarray:
    """``value`` as float64 (rows, columns) without gaps; raises on another shape and on NaN or infinity."""
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise UserError(f"{name} is not an array of numbers: give shape (rows, columns)") from None
    if array.ndim != 2:
        raise UserError(f"{name} has shape {array.shape}: give two axes (rows, columns), even for one column")
    bad = ~np.isfinite(array)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        kind = "NaN" if np.isnan(array[row, column]) else "infinity"
        more = f" ({int(bad.any(axis=1).sum())} rows in all)" if bad.any(axis=1).sum() > 1 else ""
        raise UserError(f"{kind} in row {row} of {name}, column {column}{more}: remove such rows or record again")
    return array


def stacked(q: Any, v: Any, u: Any, q_next: Any, v_next: Any) -> dict[str, np.ndarray]:
    """The five arrays as float64 (N, columns); raises where one is malformed or their shapes disagree."""
    given = (("q", q), ("v", v), ("u", u), ("q_next", q_next), ("v_next", v_next))
    arrays = {name: numbers(name, value) for name, value in given}
    rows = len(arrays["q"])
    for name, array in arrays.items():
        if len(array) != rows:
            raise UserError(f"{name} has {len(array)} rows and q has {rows}: every array needs one row per transition")
    for name, like in (("q_next", "q"), ("v_next", "v")):
        if arrays[name].shape[1] != arrays[like].shape[1]:
            columns = arrays[name].shape[1], arrays[like].shape[1]
            raise UserError(
                f"{name} and {like} have {columns[0]} and {columns[1]} columns: both need those of one robot"
            )
    nq, nv = arrays["q"].shape[1], arrays["v"].shape[1]
    if nv > nq:
        raise UserError(f"v has more columns ({nv}) than q ({nq}): are they swapped?")
    return arrays


def duration(dt: Any) -> float:
    """``dt`` as a float [s]; raises unless it is one positive, finite number."""
    value = np.asarray(dt)
    if value.size != 1 or value.dtype.kind not in "iuf" or not np.isfinite(value).all() or float(value.item()) <= 0:
        raise UserError(f"dt is {dt!r}: give the duration of one transition in seconds, one positive number")
    return float(value.item())


def episodes(episode: Any, rows: int) -> np.ndarray:
    """Episode numbers (N,) as int64; raises unless there is one whole number a row and each episode is one block."""
    array = np.asarray(episode)
    if array.shape != (rows,):
        raise UserError(f"episode has shape {array.shape}: give one whole number for each of the {rows} rows")
    numbers = array.astype(np.int64) if array.dtype.kind in "iufb" else None
    if numbers is None or not np.array_equal(numbers, array):
        raise UserError("episode is not made of whole numbers: number the episodes 0, 1, 2, ...")
    starts = np.flatnonzero(np.diff(numbers)) + 1
    blocks = numbers[np.concatenate([[0], starts])] if rows else numbers
    seen, counts = np.unique(blocks, return_counts=True)
    if (counts > 1).any():
        torn = seen[counts > 1][0]
        raise UserError(f"episode {torn} comes back after another one: keep its rows together, in time order")
    return numbers


def against_scene(data: Transitions, scene: Scene, dt: float | None = None) -> None:
    """Raises unless ``data`` can be a log of ``scene``: sizes, names, quaternions, velocities, ``dt`` [s] if given."""
    if len(data) == 0:
        raise UserError("the log is empty: record at least one transition")
    _check_sizes(data, scene)
    _check_names("joint", data.joint_names, tuple(scene.joint_names), scene)
    _check_names("actuator", data.actuator_names, tuple(scene.actuator_names), scene)
    _check_quaternions(data, scene)
    if dt is not None and abs(data.dt - dt) > TIME_STEP_TOLERANCE * dt:
        raise UserError(
            f"one transition of the log takes {data.dt:.6g} s, one step of the model {dt:.6g} s: "
            "choose substeps and time step so that substeps * time step is the log's dt"
        )
    _check_kinematics(data, scene)


def _check_sizes(data: Transitions, scene: Scene) -> None:
    found = (data.q.shape[1], data.v.shape[1], data.u.shape[1])
    wanted = (scene.nq, scene.nv, scene.nu)
    if found != wanted:
        raise UserError(
            f"log of another robot: it has (nq, nv, nu) = {found}, scene {scene.name!r} has {wanted}: "
            "give the scene that the log was recorded with (raw qpos and qvel, not clipped observations)"
        )


def _check_names(kind: str, found: tuple[str, ...], wanted: tuple[str, ...], scene: Scene) -> None:
    """Names are compared where both sides know them; unnamed joints say nothing."""
    if not all(found) or not all(wanted) or not found or not wanted or found == wanted:
        return
    if sorted(found) == sorted(wanted):
        place = next(i for i, (a, b) in enumerate(zip(found, wanted, strict=True)) if a != b)
        raise UserError(
            f"{kind} order differs: {kind} {place} is {found[place]!r} in the log and {wanted[place]!r} in scene "
            f"{scene.name!r}: reorder the columns of the log"
        )
    unknown = sorted(set(found) - set(wanted)) or sorted(set(wanted) - set(found))
    raise UserError(f"log of another robot: {kind} {unknown[0]!r} is not both in the log and in scene {scene.name!r}")


def _check_quaternions(data: Transitions, scene: Scene) -> None:
    ball = np.asarray(scene.core.jnt_type) == 2
    for address in np.asarray(scene.core.jnt_qadr)[ball]:
        for name in ("q", "q_next"):
            norm = np.linalg.norm(getattr(data, name)[:, address : address + 4], axis=1)
            bad = np.flatnonzero(np.abs(norm - 1.0) > QUATERNION_TOLERANCE)
            if len(bad):
                raise UserError(
                    f"quaternion in row {bad[0]} of {name} (columns {address} to {address + 3}) has norm "
                    f"{norm[bad[0]]:.4g}: unit quaternions in the order w x y z are needed"
                )


def _check_kinematics(data: Transitions, scene: Scene) -> None:
    """Positions must change about as the velocities say: finds swapped columns, another frame, a wrong ``dt``.

    Lenient by design (impacts change velocities within a step): refused is only a coordinate of which no
    combination of the velocities before and after explains anything.
    """
    if len(data) < ROWS_FOR_KINEMATICS:
        return
    change = scene.difference(data.q, data.q_next)
    size = np.sqrt(np.mean(change**2, axis=0))
    velocities = (data.v, data.v_next, (data.v + data.v_next) / 2)
    rest = [np.sqrt(np.mean((change - data.dt * v) ** 2, axis=0)) for v in velocities]
    unexplained = np.min(rest, axis=0) > UNEXPLAINED * size + SENSOR_NOISE
    if unexplained.any():
        raise UserError(
            f"velocity column {int(np.flatnonzero(unexplained)[0])} does not go with the change of its position over "
            f"dt = {data.dt:.6g} s: check dt, the order of columns, and the frame of angular velocities (body)"
        )
