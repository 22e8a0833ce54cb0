"""The file of a position log.

It is an npz with the keys ``time`` (T,) [s], ``joint_position`` (T, n), ``commanded_position``, ``torque`` or
``control`` (T, m), ``joint_names`` (n,), and, where known, ``actuator_names`` (m,), ``kp``, ``kd``, ``episode`` (T,).
Of a floating robot, ``base_position`` (T, 3) and ``base_quaternion`` (T, 4) besides, which are all of a tossed body;
``place_told`` is False where the former were estimated.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.data import checks
from cmbrl.errors import UserError
from cmbrl.files import check_writable

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog

BASE = ("base_position", "base_quaternion")  #: keys of the pose of a floating base
COMMANDS = {"position": "commanded_position", "torque": "torque", "control": "control"}  #: kind -> key in the file


def is_layout(keys: Any) -> bool:
    """Whether the ``keys`` of an npz are those of a position log."""
    return {"time", "joint_position"} <= set(keys) or {"time", *BASE} <= set(keys)


def check_target(path: str | os.PathLike[str]) -> None:
    """Raises UserError unless a position log can be written to ``path``; writes nothing."""
    if Path(path).suffix != ".npz":
        raise UserError(f"{path}: a position log is an npz; give NAME.npz")
    check_writable(path)


def arrays_of(log: PositionLog) -> dict[str, np.ndarray]:
    """What the file of ``log`` holds."""
    arrays: dict[str, np.ndarray] = {
        "time": log.time,
        "joint_position": log.position,
        COMMANDS[log.command_kind]: log.command,
        "joint_names": np.asarray(log.joint_names, dtype=np.str_),
    }
    if log.actuator_names:
        arrays["actuator_names"] = np.asarray(log.actuator_names, dtype=np.str_)
    if log.base is not None:
        arrays["base_position"], arrays["base_quaternion"] = log.base[:, :3], log.base[:, 3:]
        if not log.place_told:
            arrays["place_told"] = np.array(False)
    for name, gains in (("kp", log.kp), ("kd", log.kd)):
        if gains is not None:
            arrays[name] = gains[0] if len(set(gains.tolist())) == 1 else gains
    if log.n_episodes > 1:
        arrays["episode"] = log.episode
    return arrays


def fields_of(found: dict[str, np.ndarray]) -> dict[str, Any]:
    """The fields of a log by the arrays of its file; raises UserError for what is missing."""
    if set(BASE) <= set(found):
        found = dict(found)
        place, turn = (checks.numbers(key, found[key]) for key in BASE)
        if len(place) != len(turn):
            raise UserError(
                f"base_position has {len(place)} rows, base_quaternion has {len(turn)}; give one row per sample"
            )
        found["base"] = np.hstack([place, turn])
        for key in () if "joint_position" in found else ("joint_position", "commanded_position"):
            found[key] = np.zeros((len(found["base"]), 0))
        found.setdefault("joint_names", np.empty(0, dtype=np.str_))
    kind = next((kind for kind, key in COMMANDS.items() if key in found), None)
    missing = [key for key in ("time", "joint_position", "joint_names") if key not in found]
    if kind is None or missing:
        raise UserError(
            f"no {', '.join(missing) or 'commanded_position, no torque and no control'} in the file (it has "
            f"{', '.join(sorted(found)) or 'nothing'}); a position log needs time, joint_position, joint_names, and "
            "commanded_position, torque or control, without columns where nothing is driven"
        )
    fields: dict[str, Any] = {
        key: found[key]
        for key in ("time", "joint_names", "kp", "kd", "episode", "actuator_names", "base")
        if key in found
    }
    if "place_told" in found:
        fields["place_told"] = found["place_told"].tolist()
    return fields | {"position": found["joint_position"], "command": found[COMMANDS[kind]], "command_kind": kind}
