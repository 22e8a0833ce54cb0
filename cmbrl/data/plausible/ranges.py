"""Controls and torques that no actuator of the file can take: another unit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.drive import law_of
from cmbrl.data.fields import Fields
from cmbrl.data.plausible.finding import Finding

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene

_OFTEN, _BEYOND = 50.0, 1.0  # percent of the samples; ranges of controls
_ROOM = 1.05  # times the largest force, within which controls may be forces


def of_transitions(log: Fields, scene: Scene) -> Iterator[Finding]:
    """Controls of transitions, more than half of which lie beyond the range by more than that range.

    The file cuts them off at its range. A few beyond, as in a policy's raw output, do no harm.
    """
    for actuator in range(scene.nu):
        yield from _beyond(log["u"][:, actuator], actuator, scene, "u", 1.0)


def of_positions(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """The same of a position log's controls and torques; targets are told where they become controls (``drive``)."""
    for column, actuator in enumerate(log.actuators(scene).tolist()):
        kind, scale = law_of(scene, actuator)
        if log.command_kind == "control":
            yield from _beyond(log.command[:, column], actuator, scene, "control", 1.0)
        elif log.command_kind == kind == "torque":
            yield from _beyond(log.command[:, column], actuator, scene, "torque", scale)


def _beyond(taken: np.ndarray, actuator: int, scene: Scene, called: str, scale: float) -> Iterator[Finding]:
    """Of the column ``taken`` (T,) of ``actuator``, which the log calls ``called``; ``scale`` times it are controls."""
    low, high = np.sort(scene.core.act_ctrl[actuator] / scale).tolist()
    room = high - low
    if not (np.isfinite(room) and room > 0.0 and len(taken)):
        return
    if not np.percentile(np.maximum(taken - high, low - taken), _OFTEN) > _BEYOND * room:
        return
    gear, gain = (float(scene.core.P[scene.layout.actuator(actuator, field)]) for field in ("gear", "gain"))
    reach, strength = float(np.abs(taken).max()), abs(gear * gain)
    forces = called != "torque" and strength > 1.0 and reach <= _ROOM * strength * max(abs(low), abs(high))
    cause = f"forces instead of controls? Divide the column by {strength:.4g}" if forces else "check its unit"
    # a column of controls becomes torques by gear and gain, and the user knows its own numbers
    control = "" if abs(scale) == 1.0 else f", a control of {reach * abs(scale):.4g} times {_by(gear, gain)}"
    yield Finding(
        f"{called} of {scene.actuator_names[actuator]!r} reaches {reach:.4g}{control}, and mostly lies far beyond what "
        f"the file's actuator takes, {low:.4g} to {high:.4g}: {cause}, or the range in the file"
    )


def _by(gear: float, gain: float) -> str:
    """What makes a torque of a control."""
    return f"the gear of {gear:.4g}" if gain == 1.0 else f"gear and gain of {gear * gain:.4g}"
