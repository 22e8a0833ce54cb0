"""Several logs of one robot as one: the rows in order, and which log each is from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.data import drive
from cmbrl.data.checks import TIME_STEP_TOLERANCE
from cmbrl.data.estimation import estimated
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.data.unlogged import with_columns
from cmbrl.errors import UserError
from cmbrl.numbers import shown

if TYPE_CHECKING:
    from cmbrl.scene import Scene

Log = Transitions | PositionLog
Logs = Log | Sequence[Log] | Mapping[str, Log]  #: one log, several, or several by name


def named_logs(data: Any) -> dict[str, Log]:
    """``data`` by name: its own, or "log 1" and so on. Raises UserError for what is no log, and for both kinds at once.

    The time steps are those of the first, within a tolerance.
    """
    if isinstance(data, Mapping):
        logs = dict(data)
    else:
        several = data if isinstance(data, list | tuple) else [data]
        logs = {f"log {k + 1}": log for k, log in enumerate(several)}
    if not logs or not all(isinstance(log, Transitions | PositionLog) for log in logs.values()):
        raise UserError(f"data = {shown(data)}: give Transitions or a PositionLog, or a list of logs of one kind")
    first, known = next(iter(logs)), next(iter(logs.values()))
    for name, log in logs.items():
        if type(log) is not type(known):
            raise UserError(
                f"{name} and {first}: one is a log of states, the other of positions; fit them apart, or import both "
                "alike by `cmbrl import --as`"
            )
        if abs(log.dt - known.dt) > TIME_STEP_TOLERANCE * known.dt:
            raise UserError(
                f"{name} has a sample every {log.dt:.6g} s, {first} every {known.dt:.6g} s: bring them to one rate by "
                "`cmbrl import --rate`"
            )
    return logs


def scene_of_logs(logs: Mapping[str, Log], scene: Scene) -> Scene:
    """``scene`` as the commands of position ``logs`` ask for; raises UserError that names the log (``drive``)."""
    for name, log in logs.items():
        try:
            scene = drive.scene_of(log, scene) if isinstance(log, PositionLog) else scene
        except UserError as error:
            raise UserError(f"{name}: {error}" if len(logs) > 1 else str(error)) from None
    return scene


def together(logs: Mapping[str, Log], scene: Scene, dt: float | None = None) -> Transitions:
    """The rows of all ``logs`` of ``scene``, with estimated velocities if they are of positions.

    ``recording`` numbers the logs. Raises UserError that names the log which is not one of ``scene``, or not of time
    step ``dt`` [s] if given.
    """
    parts = []
    for name, log in logs.items():
        try:
            part = estimated(log, scene) if isinstance(log, PositionLog) else with_columns(log, scene)
            part.check(scene, dt)
            part = part.going_on(scene)
        except UserError as error:
            raise UserError(f"{name}: {error}" if len(logs) > 1 else str(error)) from None
        parts.append(part)
    if len(parts) == 1:
        return parts[0]
    rows = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return replace(Transitions.joined([replace(part, dt=parts[0].dt) for part in parts]), recording=rows)
