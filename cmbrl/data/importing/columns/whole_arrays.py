"""What is told of whole arrays: that they hold a quantity of all joints or actuators, or are of no use."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping

from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.importing.columns.state import arrays, layout
from cmbrl.data.importing.columns.units import SINGLE
from cmbrl.data.importing.columns.words import WORDS
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.info.columns import counted

_CONTROL = "control"


def by_column(given: Mapping[str, str], columns: Collection[str], scene: Scene) -> dict[str, str]:
    """``given`` for single columns: the name of an array, or of a group of arrays, stands for all columns in it.

    Its text is ``-``, or a quantity and perhaps a unit (``position:deg``, ``control``): of the joint or the actuator
    that a column is named after, or of all of them in the order of the file, or of all joints that an actuator drives
    where there are as many columns. What is told of one column counts more.
    Names that are not there stay as they are. Raises UserError for an array with another number of columns.
    """
    arrays = {name: members for name in given if name not in columns and (members := _members(name, columns))}
    found: dict[str, str] = {}
    for name, members in arrays.items():
        found |= (
            dict.fromkeys(members, "-") if given[name].strip() == "-" else _owned(name, members, given[name], scene)
        )
    return found | {name: text for name, text in given.items() if name not in arrays}


def hint(columns: Iterable[str], targets: Collection[str], scene: Scene) -> str:
    """How to tell what the columns of an array without names are; empty where there is none."""
    found = {name: len(parts) for name, parts in arrays([x for x in columns if x not in targets]).items()}
    single, floating = joints_of(scene)
    if floating:  # a width that fits nothing cannot be told
        found = {name: count for name, count in found.items() if count in (len(single), scene.nq)}
    names = [name for name, count in found.items() if count > 1]
    if not names:
        return ""
    said = [name for name in names if WORDS["position"] & set(re.split(r"[^a-z]+", name.lower()))]
    name = [*said, *names][0]
    by_joints = " (--joints names them)" if found[name] == len(single) else ""
    return f", or say what all columns of an array are, as --map {name}=position{by_joints}"


def _members(name: str, columns: Iterable[str]) -> list[str]:
    numbered = re.compile(re.escape(name) + r"_?\d+")  # of a table without arrays
    return [x for x in columns if x.startswith((f"{name}.", f"{name}[")) or numbered.fullmatch(x)]


def _owned(name: str, members: list[str], text: str, scene: Scene) -> dict[str, str]:
    quantity = text.partition(":")[0].strip()
    if quantity not in (*SINGLE, _CONTROL):
        raise UserError(
            f"--map: {name!r} is an array: say - or which quantity it holds of all joints, as position:deg "
            f"({', '.join((*SINGLE, _CONTROL))})"
        )
    what = "actuator" if quantity == _CONTROL else "joint"
    owners = scene.actuator_names if quantity == _CONTROL else [joint.name for joint in joints_of(scene)[0]]
    names = [column[len(name) + 1 :] for column in members]
    driven = [joint.name for joint in joints_of(scene)[0] if joint.vadr in set(scene.core.act_line.tolist())]
    if what == "joint" and len(members) == len(driven) != len(owners) and not set(names) <= set(owners):
        owners = driven  # others are passive, or follow by ties
    if not set(names) <= set(owners):
        if len(members) != len(owners):
            raise UserError(
                f"--map: {name!r} has {counted(len(members), 'column')} and the robot {counted(len(owners), what)}"
                f"{_of_state(quantity, scene)}: name its columns by --joints"
            )
        names = list(owners)
    return {column: f"{owner}.{text.strip()}" for column, owner in zip(members, names, strict=True)}


def _of_state(quantity: str, scene: Scene) -> str:
    """How many numbers MuJoCo has of a ``quantity``, where free and ball joints make them more than the joints."""
    count = len(layout(scene)[quantity]) if quantity in ("position", "velocity") and joints_of(scene)[1] else 0
    return f" ({counted(count, 'number')} with free and ball joints)" if count else ""
