"""Gains of the position servos of a log: as told by option, by the log, or by the file, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cmbrl.data.importing.columns.targets import match
from cmbrl.data.importing.commands.commanded import Commanded
from cmbrl.data.importing.recording import Recording
from cmbrl.errors import UserError, did_you_mean
from cmbrl.scene import Scene

ALL = ""  #: key of the gain of all joints that are not named
Gains = float | Mapping[str, float] | None  #: one for all joints, or by joint


def gains_of(
    kp: Gains, kd: Gains, recording: Recording, commanded: Commanded | None, scene: Scene
) -> dict[str, float | np.ndarray | None]:
    """``kp`` and ``kd``, else those of ``recording``: one number, or one by command, in their order.

    Joints that neither names keep the file's. Raises UserError for unknown joints, and motors without a gain.
    """
    found: dict[str, float | np.ndarray | None] = {}
    owners = commanded.joints(scene) if commanded else []
    for name, given in (("kp", kp), ("kd", kd)):
        held = {key: x for key, x in recording.constants.items() if key.partition(".")[0] == name}
        if isinstance(given, Mapping):
            found[name] = _by_joint(name, given, commanded, owners, scene)
        elif given is not None or not held:
            found[name] = given
        else:
            found[name] = held[name] if name in held else _logged(name, held, owners, recording.where, scene)
    return found


def _by_joint(
    name: str, given: Mapping[str, float], commanded: Commanded | None, owners: Sequence[str], scene: Scene
) -> np.ndarray:
    if unknown := [joint for joint in given if joint not in (ALL, *owners)]:
        raise UserError(f"--{name}: no command of {unknown[0]!r} in the log: {did_you_mean(unknown[0], owners)}")
    return np.array([
        given[owner] if owner in given else given[ALL] if ALL in given else _of_file(name, owner, actuator, scene)
        for owner, actuator in zip(owners, commanded.actuators if commanded else (), strict=True)
    ])  # fmt: skip


def _of_file(name: str, owner: str, actuator: int, scene: Scene) -> float:
    """The gain that the file gives to ``actuator``; 0 for a kd that it does not have."""
    value = file_gain(name, actuator, scene)
    if value is None and name == "kp":
        raise UserError(f"no kp for {owner!r}, which is a motor in the file: give --kp {owner}=X, or --kp X for all")
    return value or 0.0


def file_gain(name: str, actuator: int, scene: Scene) -> float | None:
    """``name``, kp or kd, of ``actuator`` at its joint; None where the file has none."""
    values = {parameter.name: parameter.nominal for parameter in scene.parameters}
    value = values.get(f"{name}.{scene.actuator_names[actuator]}")
    return None if value is None else value * float(scene.core.P[scene.layout.actuator(actuator)]) ** 2


def _logged(name: str, held: Mapping[str, Any], owners: Sequence[str], where: str, scene: Scene) -> np.ndarray:
    columns = {f"{key.partition('.')[2]}.position": x for key, x in held.items()}
    by_owner = {target.owner: columns[column] for column, target in match(columns, {}, scene).items()}
    if unknown := [joint for joint in owners if joint not in by_owner]:
        raise UserError(f"{where}: {name} has no number for joint {unknown[0]!r}; give --{name}")
    if changed := [joint for joint in owners if np.isnan(by_owner[joint])]:
        raise UserError(f"{where}: {name} of {changed[0]!r} changes: import a part where it holds, or give --{name}")
    return np.array([by_owner[joint].item() for joint in owners])
