"""What may be wrong with the columns of a log, and the log with them put right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from cmbrl.data.drive import law_of
from cmbrl.data.plausible.readings import READINGS, Reading, reread
from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene
from cmbrl.scene.records import Joint, JointKind

_DEGREES, _MILLIMETRES = 180.0 / np.pi, 1e3
MOST = 12  #: columns in doubt: of more, the file is to blame


@dataclass(frozen=True)
class Doubt:
    """Columns that may be wrong: of the positions of ``joints``, or of ``controls``.

    One is to be divided by ``factor``, two are to be exchanged. ``text`` says so.
    """

    text: str
    joints: tuple[Joint, ...] = ()
    controls: tuple[int, ...] = ()
    factor: float = 1.0

    @property
    def dofs(self) -> tuple[int, ...]:
        """Places of the joints in v."""
        return tuple(joint.vadr for joint in self.joints)

    def resolved(self, log: Transitions) -> Transitions:
        """``log`` with the columns as they should be."""
        places = {"q": [joint.qadr for joint in self.joints], "v": list(self.dofs), "u": list(self.controls)}
        changed = {}
        for name in ("q", "q_next", "v", "v_next", "u"):
            columns, values = places[name[0]], getattr(log, name).copy()
            values[:, columns] = values[:, columns[::-1]] / self.factor
            changed[name] = values
        return replace(log, **changed)


@dataclass(frozen=True)
class Misread:
    """Quaternions of a ball ``joint`` that ``reading`` makes right. ``text`` says so."""

    text: str
    joint: Joint
    reading: Reading

    @property
    def dofs(self) -> tuple[int, ...]:
        """Its places in v."""
        return tuple(self.joint.dofs)

    def resolved(self, log: Transitions) -> Transitions:
        """``log`` with the quaternions as they should be, and the angular velocities that follow."""
        turn, rate = slice(self.joint.qadr, self.joint.qadr + 4), slice(self.joint.vadr, self.joint.vadr + 3)
        q, v, q_next, v_next = (getattr(log, name).copy() for name in ("q", "v", "q_next", "v_next"))
        for states, rates in ((q, v), (q_next, v_next)):
            states[:, turn], rates[:, rate] = reread(self.reading, states[:, turn], rates[:, rate])
        return replace(log, q=q, v=v, q_next=q_next, v_next=v_next)


def of_columns(scene: Scene, unconfirmed: Sequence[Joint], badly: Sequence[Joint], positions: bool) -> Iterator[Doubt]:
    """What may be wrong with the columns of joints that are ``badly`` explained, or with controls that are forces.

    Those with a servo are in doubt only together with one of the ``unconfirmed``. ``positions``: of a position log.
    """
    joints = [joint for joint in badly if joint in unconfirmed]
    kind = "joint_position" if positions else "q"
    for joint in joints:
        column, place = f"{kind} of joint {joint.name!r}", (joint,)
        yield Doubt(f"{column} is explained with the other sign: a sign error? Negate the column", place, (), -1.0)
        slides = joint.kind == JointKind.SLIDE
        factor, unit = (_MILLIMETRES, "mm, not m") if slides else (_DEGREES, "degrees, not radians")
        yield Doubt(f"{column} is explained as {unit}: divide the column by {factor:.4g}", place, (), factor)
    for first, second in combinations(badly, 2):
        if first.kind == second.kind and (first in joints or second in joints):
            both = f"{kind} of joints {first.name!r} and {second.name!r}"
            yield Doubt(f"{both} is explained the other way round: are they swapped?", (first, second))
    forces = [a for a in range(scene.nu) if law_of(scene, a)[0] != "position"][:MOST]
    for a in forces:
        text = f"the control of {scene.actuator_names[a]!r} acts the other way: a sign error? Negate the column"
        yield Doubt(text, (), (a,), -1.0)
    for a, b in combinations(forces, 2):
        names = f"{scene.actuator_names[a]!r} and {scene.actuator_names[b]!r}"
        yield Doubt(f"the controls of {names} act the other way round: are they swapped?", (), (a, b))


def of_turns(turns: Sequence[Joint], positions: bool) -> Iterator[Misread]:
    """In which other ways the quaternions of the ball joints ``turns`` may be meant."""
    for joint in turns:
        place = f"q of joint {joint.name!r}, columns {joint.qadr} to {joint.qadr + 3},"
        for text, reading in READINGS.items():
            yield Misread(f"{'base_quaternion' if positions else place} is explained if {text}", joint, reading)
