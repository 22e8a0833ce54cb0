"""What a column is: a quantity of a joint or an actuator, in a unit; given by the user or recognised by its name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, TURN, Floating, Single, joints_of
from cmbrl.data.importing.columns import named_units
from cmbrl.data.importing.columns.units import TURN_UNITS, UNITS, affine_of, dimension_of, factor_of
from cmbrl.data.importing.columns.words import (
    CLOCKS,
    EPISODES,
    OF_BODIES,
    OTHER,
    PLAIN,
    POSES,
    TIMES,
    UNNAMED,
    WORDS,
    YIELDS,
)
from cmbrl.data.importing.commands.commanded import paced
from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import shown

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_AFFINE = ("position", "command")  # of single joints: what may count from another zero
BASE = "base"  #: the only free joint


@dataclass(frozen=True)
class Target:
    """``quantity`` of the joint or actuator ``owner`` ("" for time, episode); in SI it is ``factor`` x + ``zero``."""

    owner: str
    quantity: str
    factor: float = 1.0
    zero: float = 0.0
    told: str = field(default="", compare=False)  #: what its name has made of it, where a user should know

    @property
    def key(self) -> tuple[str, str]:
        """What no two columns may share."""
        return self.owner, self.quantity


def parse(text: str, scene: Scene, column: str = "", angles: str = "rad") -> Target | None:
    """``joint.quantity:unit``, ``base.qw``, ``actuator.control``, ``time:ms`` or ``episode``; None for ``-``.

    A unit may have a factor before it and what is to be added behind it, as ``-deg+90``; ``percent`` and ``+-percent``
    are of the joint's range. Where there is none, the name of the ``column`` may tell it (``J1 [deg]``); ``angles`` is
    that of other hinges. Raises UserError that names what is unknown, and the nearest.
    """
    word, _, unit = text.strip().partition(":")
    word, unit = word.strip(), unit.strip()
    if word == "-":
        return None
    if word in ("time", "episode"):
        return Target("", word, factor_of(unit or named_units.of_column(column, word, text), word, text))
    owner, dot, quantity = word.rpartition(".")
    if not dot:
        raise UserError(f"--map: {shown(text)}: give JOINT.QUANTITY:UNIT, ACTUATOR.control, time:UNIT, episode or -")
    single, floating = joints_of(scene)
    if quantity == "control":
        if owner not in scene.actuator_names:
            raise UserError(f"--map: no actuator {owner!r}: {did_you_mean(owner, scene.actuator_names)}")
        return Target(owner, quantity, factor_of(unit, "number", text))
    body = _base(floating) if owner == BASE and owner not in scene.joint_names else None
    known: list[Single | Floating] = [body] if body else [*single, *floating]
    for joint in known:
        if joint is not body and joint.name != owner:
            continue
        pace = quantity == "command" and joint.name in paced(scene)
        dimension = dimension_of(joint, "velocity" if pace else quantity)
        if unit in ("", "-"):  # of a sign alone the name still tells the unit
            unit += named_units.of_column(column, dimension, text, angles if isinstance(joint, Single) else "rad")
        if isinstance(joint, Single) and quantity in _AFFINE and not pace:
            return Target(joint.name, quantity, *affine_of(unit, dimension, joint, scene, text))
        return Target(joint.name, quantity, factor_of(unit, dimension, text))
    raise UserError(f"--map: no joint {owner!r}: {did_you_mean(owner, scene.joint_names)}")


def _base(floating: list[Floating]) -> Floating | None:
    free = [joint for joint in floating if joint.free]
    return free[0] if len(free) == 1 else None


def match(columns: Iterable[str], given: Mapping[str, str], scene: Scene, angles: str = "rad") -> dict[str, Target]:
    """Targets of ``columns``: those in ``given`` as they are, others by their names. Columns of no use are left out.

    ``angles``: the unit of hinges, where nothing else tells it. Raises UserError if two columns have one target, or
    ``given`` names a column that is not there.
    """
    names = list(columns)
    for column in given:
        if column not in names:
            raise UserError(f"--map: no column {column!r} in the log: {did_you_mean(column, names)}")
    found: dict[str, Target] = {}
    told = {column: parse(text, scene, column, angles) for column, text in given.items()}
    taken = {target.key: column for column, target in told.items() if target}
    if len(taken) < sum(target is not None for target in told.values()):
        raise UserError("--map: two columns have the same target; drop one")
    guesser = _Guesser(scene, angles)
    for column in names:
        target = told[column] if column in told else guesser.target(column)
        if target is None or (column not in told and target.key in taken and taken[target.key] in told):
            continue
        other = taken.get(target.key, column)
        if other != column and column not in told and (_yields(column) or _yields(other)):
            if _yields(column):
                continue
            del found[other]
        elif other != column:
            what = ".".join(filter(None, target.key))
            raise UserError(
                f"columns {other!r} and {column!r} both look like {what}; drop one by --map {_array(other)}=- or "
                f"--map {_array(column)}=-, or say what it is by --map {column}=JOINT.QUANTITY:UNIT"
            )
        taken[target.key] = column
        found[column] = target
    return found


class _Guesser:
    """Recognises columns by the names of joints and actuators, and by words of quantities."""

    def __init__(self, scene: Scene, angles: str) -> None:
        self.scene = scene
        self.single, floating = joints_of(scene)
        self.floating, self.bodies = _base(floating), floating
        self.angle = TURN_UNITS[angles]
        self.actuators, self.paced = scene.actuator_names, paced(scene)
        self.drivers = {name.lower(): name for name in scene.actuator_names}  # a joint's name may be the same
        owners: dict[str, tuple[str, bool]] = {}
        for name in scene.actuator_names:
            owners[name.lower()] = (name, True)
        for joint in self.single:
            owners[re.sub(r"_?joint$", "", joint.name.lower())] = (joint.name, False)
        for joint in self.single:
            owners[joint.name.lower()] = (joint.name, False)
        self.owners = {name: owner for name, owner in owners.items() if name}
        longest = sorted(self.owners, key=len, reverse=True)
        self.pattern = (
            re.compile(f"(?<![a-z0-9])({'|'.join(map(re.escape, longest))})(?![a-z0-9])") if longest else None
        )

    def target(self, column: str) -> Target | None:
        """What ``column`` is, None if its name does not tell."""
        name = column.lower()
        if name in EPISODES:
            return Target("", "episode")
        if name in CLOCKS:
            return Target("", "time", CLOCKS[name])
        stem, _, last = re.sub(r"[ _]*[\[(](\w+)[\])]$", r"_\1", name).rpartition("_")
        if name in TIMES or (stem in TIMES and last in UNITS["time"]):
            return Target("", "time", UNITS["time"].get(last, 1.0))
        name, unit = named_units.split(name)
        own = self._of_body(name) if name not in self.owners else None
        hit = self.pattern.search(name) if self.pattern else None
        if own is not None or hit is None:
            return self._placed(own or self._of_base(name), unit)
        words = set(re.split(r"[^a-z]+", name[: hit.start()] + " " + name[hit.end() :]))
        if words & OTHER:
            return None
        unit = named_units.of_words(words) if unit is None else unit
        owner, actuator = self.owners[hit.group(1)]
        quantity = _quantity(words, owner in self.paced)
        if quantity is None:
            if words - PLAIN - named_units.WORDS:
                return None
            quantity = named_units.told_by(unit) or ("control" if actuator else "position")
        joint = next((one for one in self.single if one.name == owner), None)
        if quantity == "control" or (joint is None and quantity == "command"):  # of an actuator with a name of its own
            known = self.drivers.get(hit.group(1), owner)
            return Target(known, "control") if known in self.actuators else None
        if joint is None:
            return None
        if unit is not None:
            return self._in(unit, joint, quantity, column)
        return Target(joint.name, quantity, self.angle if joint.hinge and quantity != "torque" else 1.0)

    def _placed(self, own: Target | None, unit: str | None) -> Target | None:
        """A coordinate of a body in the ``unit`` that its name tells, if any; None where it has no such unit."""
        if own is None or unit is None:
            return own
        body = next(joint for joint in self.bodies if joint.name == own.owner)
        kind = dimension_of(body, own.quantity)
        if kind == "number":
            return own
        return replace(own, factor=UNITS[kind][unit]) if unit in UNITS[kind] else None

    def _in(self, unit: str, joint: Single, quantity: str, column: str) -> Target | None:
        """``quantity`` of ``joint`` in a unit that the name of the column tells; None where it has no such unit."""
        kind = dimension_of(joint, "velocity" if quantity == "command" and joint.name in self.paced else quantity)
        if unit in UNITS[kind]:
            return Target(joint.name, quantity, UNITS[kind][unit])
        if unit != named_units.PERCENT or not joint.limited or kind not in ("angle", "length"):
            return None
        factor, zero = affine_of(unit, kind, joint, self.scene, column)
        told = f"in percent of the range of {joint.name!r}: 0 at {zero:.4g} and 100 at {zero + 100 * factor:.4g}"
        return Target(joint.name, quantity, factor, zero, told)

    def _of_body(self, name: str) -> Target | None:
        """A coordinate of a ball joint, or of a free one, after the joint's name: ``shoulder_qw``, ``pose.cube.x``."""
        *_, last = re.split(r"[._/ ]", name)
        for joint in self.bodies:
            own = re.sub(r"_?joint$", "", joint.name.lower()) or joint.name.lower()
            if last not in {**joint.position, **joint.velocity}:
                continue
            words = re.split(rf"(?<![a-z0-9]){re.escape(own)}(?![a-z0-9])", name[: len(name) - len(last)])
            if len(words) == 2 and not set(re.split(r"[^a-z]+", " ".join(words))) - PLAIN - OF_BODIES:
                return Target(joint.name, last)
        return None

    def _of_base(self, name: str) -> Target | None:
        *head, last = re.split(r"[._/ ]", name)
        words = set(re.split(r"[^a-z]+", " ".join(head)))
        for letter, kind in POSES.items():
            if words & kind and letter + last in (*PLACE, *TURN):
                last, words = letter + last, words - kind
        if self.floating is None or last not in (*PLACE, *TURN, *LINEAR, *ANGULAR):
            return None
        words -= PLAIN
        if words - {BASE, "root", "pose", "odom", "odometry", "mocap", "imu", self.floating.name.lower()}:
            return None
        return Target(self.floating.name, last)


def _array(column: str) -> str:
    """The array, or the topic's field, that a column is of; its own name where it is of none."""
    unnamed = UNNAMED.fullmatch(column)
    return unnamed["array"] if unnamed else column.rpartition(".")[0] or column


def _yields(column: str) -> bool:
    return not YIELDS.isdisjoint(re.split(r"[^a-z]+", column.lower()))


def _quantity(words: set[str], paced: bool) -> str | None:
    """The quantity that words of a name tell. A commanded velocity is the command of a ``paced`` joint alone."""
    said = {quantity for quantity, known in WORDS.items() if words & known}
    if "command" in said and "velocity" in said:
        return "command" if paced else None
    return next((quantity for quantity in WORDS if quantity in said), None)
