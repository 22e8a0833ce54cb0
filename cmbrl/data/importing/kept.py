"""Which columns an import has understood though the log that it writes has no place for them: said, with the reason."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, TURN, joints_of
from cmbrl.data.importing.columns.targets import Target
from cmbrl.data.importing.commands.commanded import Commanded
from cmbrl.data.importing.commands.controls import taken
from cmbrl.data.importing.grid import Key
from cmbrl.data.importing.series import HELD
from cmbrl.data.importing.told import used
from cmbrl.scene import Scene

ReadAs = tuple[Sequence[str], Mapping[str, Target]]  #: columns of a recording, and what those are that were understood

_PLACES = {"position", *PLACE, *TURN}
_WHY = {
    "positions": "a position log holds positions and commands, and a fit estimates the velocities",
    "transitions": "transitions hold positions, velocities and controls",
}


def columns_told(read_as: ReadAs, keys: set[Key], kind: str, scene: Scene, idle: Collection[str]) -> list[str]:
    """What columns are, and which are not in a log of this ``kind``, of a recording that tells ``keys``.

    ``idle``: joints whose commands no actuator takes, which another note tells.
    """
    columns, targets = read_as
    held = _of_transitions(keys, scene) if kind == "transitions" else _commands(keys, scene)
    lost = {c for c, t in targets.items() if t.owner and t.quantity not in _PLACES and t.key not in held}
    taken_by_none = {c for c in lost if targets[c].quantity in HELD and targets[c].owner in idle}
    return used(columns, {c: t for c, t in targets.items() if c not in taken_by_none}, lost, _WHY[kind])


def _of_transitions(keys: set[Key], scene: Scene) -> Collection[Key]:
    """Controls and velocities of transitions; of a base, its three numbers or none."""
    single, floating = joints_of(scene)
    whole = [{(base.name, name) for name in names} for base in floating for names in (LINEAR, ANGULAR)]
    of_bases = {key for three in whole if three <= keys for key in three}
    return taken(keys, scene) | {(joint.name, "velocity") for joint in single} | of_bases


def _commands(keys: set[Key], scene: Scene) -> Collection[Key]:
    commanded = Commanded.of(keys, scene)
    return commanded.keys if commanded else ()
