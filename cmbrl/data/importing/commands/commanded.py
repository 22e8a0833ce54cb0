"""What columns command the actuators of a position log: targets or torques of joints, or controls of actuators."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cmbrl.data.drive import law_of
from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.importing.grid import Key
from cmbrl.errors import UserError
from cmbrl.scene import Scene

Kind = Literal["position", "torque", "control"]
# quantity of a column -> kind of command
_KINDS: dict[str, Kind] = {"command": "position", "torque": "torque", "control": "control"}
# law of an actuator -> quantity of its joint's column
_OF_LAWS = {"position": "command", "velocity": "command", "torque": "torque"}


@dataclass(frozen=True)
class Commanded:
    """Columns ``keys`` (m,) that command ``actuators`` (m,), each with the ``factors`` (m,) to what ``kind`` means.

    ``names`` (m,) of these actuators; empty where each joint has its own, in the order of the scene.
    """

    kind: Kind
    actuators: tuple[int, ...]
    keys: tuple[Key, ...]
    factors: np.ndarray
    names: tuple[str, ...]

    @classmethod
    def of(cls, keys: set[Key], scene: Scene) -> Commanded | None:
        """Of a log with the columns ``keys``: what every actuator has, targets before torques, or else controls.

        None if some actuator has nothing. Controls are for robots with actuators of several kinds, and servos of
        velocities.
        """
        for quantity in _KINDS if scene.nu else ():
            found = [next((s for s in _sources(scene, a, quantity) if s[0] in keys), None) for a in range(scene.nu)]
            if (told := [source for source in found if source]) and len(told) == scene.nu:
                return cls._ordered(scene, _KINDS[quantity], told)
        return None

    @classmethod
    def _ordered(cls, scene: Scene, kind: Kind, told: list[tuple[Key, float]]) -> Commanded:
        lines, places = scene.core.act_line.tolist(), [joint.vadr for joint in joints_of(scene)[0]]
        order, names = list(range(scene.nu)), scene.actuator_names
        if sorted(lines) == sorted(places):
            order, names = [lines.index(place) for place in places], ()
        keys, factors = zip(*(told[a] for a in order), strict=True)
        return cls(kind, tuple(order), keys, np.array(factors), tuple(names))

    def joints(self, scene: Scene) -> list[str]:
        """The joints that are commanded, in the order of the columns; of tendons and sites, the actuators."""
        return [_joint_of(scene, a) or scene.actuator_names[a] for a in self.actuators]


def wanted(keys: set[Key], scene: Scene) -> UserError:
    """The error of a log in which an actuator has no command."""
    lacks = next((a for a in range(scene.nu) if not any(s in keys for s, _ in _all_sources(scene, a))), 0)
    joint, control = _joint_of(scene, lacks), f"{scene.actuator_names[lacks]}.control"
    if joint is None:
        return UserError(f"no command for every actuator: map a column to {control} by --map COLUMN={control}")
    return UserError(
        f"no command for every joint: map a column to {joint}.command or {joint}.torque by --map COLUMN={joint}.command"
    )


def idle(keys: set[Key], scene: Scene) -> list[str]:
    """Joints, in the scene's order, whose targets or torques ``keys`` tell though no actuator takes them.

    Raises UserError where that are all that were told: such a scene would explain the motion without its motors.
    """
    taken = {key for a in range(scene.nu) for key, _ in _all_sources(scene, a)}
    told = [(joint.name, quantity) for joint in joints_of(scene)[0] for quantity in dict.fromkeys(_OF_LAWS.values())]
    left = [key for key in told if key in keys - taken]
    if left and not scene.nu:
        kind = "motor" if all(quantity == "torque" for _, quantity in left) else "position --kp GAIN"
        remedy = "add them to the file"
        if scene.urdf_changes:
            remedy = f"make an MJCF with them by `cmbrl convert FILE.urdf FILE.xml --actuators {kind}`"
        raise UserError(
            f"the log tells {'.'.join(left[0])}, and scene {scene.name!r} has no actuators: {remedy}, or leave the "
            "column out by --map COLUMN=-"
        )
    return list(dict.fromkeys(name for name, _ in left))


def paced(scene: Scene) -> set[str]:
    """Joints that servos of velocities drive: their commands are velocities."""
    own = [_joint_of(scene, a) for a in range(scene.nu) if law_of(scene, a)[0] == "velocity"]
    return {joint for joint in own if joint is not None}


def _joint_of(scene: Scene, actuator: int) -> str | None:
    """The joint that ``actuator`` alone drives; None for one at a tendon, a site, or beside another one."""
    lines = scene.core.act_line.tolist()
    own = lines[actuator] if lines.count(lines[actuator]) == 1 else -1
    return next((joint.name for joint in joints_of(scene)[0] if joint.vadr == own), None)


def _sources(scene: Scene, actuator: int, quantity: str) -> Iterator[tuple[Key, float]]:
    """Columns that tell the ``quantity`` of ``actuator``, each with the factor to it: command, torque or control.

    The command of a servo of velocities is a velocity, which goes into controls and is no target of a position.
    """
    joint, (kind, scale) = _joint_of(scene, actuator), law_of(scene, actuator)
    if quantity == "control":
        yield (scene.actuator_names[actuator], quantity), 1.0
        if joint and kind in _OF_LAWS:
            yield (joint, _OF_LAWS[kind]), scale
        return
    if joint and (kind, quantity) != ("velocity", "command"):
        yield (joint, quantity), 1.0
    if kind == _KINDS[quantity]:
        yield (scene.actuator_names[actuator], "control"), 1.0 / scale


def _all_sources(scene: Scene, actuator: int) -> Iterator[tuple[Key, float]]:
    for quantity in _KINDS:
        yield from _sources(scene, actuator, quantity)
