"""MuJoCo's whole state in arrays whose columns have no names: qpos, qvel, ctrl, with free and ball joints."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from cmbrl.data.importing.bodies import Floating, Single, joints_of
from cmbrl.data.importing.columns.words import UNNAMED

if TYPE_CHECKING:
    from cmbrl.data.importing.options import Options
    from cmbrl.data.importing.recording import Recording
    from cmbrl.scene import Scene

_NUMBERED = re.compile(r"(?P<array>.*[^\d_])_?\d+")  # a column of an array in a table
_CALLED = {"qpos": "position", "qvel": "velocity", "ctrl": "control"}


def resolved(options: Options, recording: Recording, scene: Scene) -> tuple[Options, list[str]]:
    """``options`` that tell every column of the arrays with MuJoCo's state, and a note that names these.

    They are called so, or said to hold position or velocity, and have as many columns. What is told of a column or of
    another array counts more than a name. MuJoCo's angular velocities are in the axes of the body.
    """
    columns = [name for table in recording.tables for name in table.columns]
    found: dict[str, str] = {}
    names = []
    for quantity, parts in layout(scene).items():
        name = _holding(quantity, len(parts), options.columns, columns, scene)
        if name is None:
            continue
        names.append(name)
        told = {text.partition(":")[0].strip() for text in options.columns.values()}
        unit = options.columns.get(name, "").partition(":")[2].strip()
        for column, part in zip(arrays(columns)[name], parts, strict=True):
            if part not in told:
                found[column] = f"{part}:{unit}" if unit and part.endswith(quantity) else part
    if not names:
        return options, []
    given = {name: text for name, text in options.columns.items() if name not in names}
    note, frames = f"{', '.join(names)}: MuJoCo's order of all numbers of the robot", options.frames
    if any(part.endswith(".wx") for part in found.values()):
        frames = replace(frames, angular=frames.angular or "body")
        note += f", angular velocities in the axes of the {frames.angular}"
    return replace(options, columns=found | given, frames=frames), [note]


def layout(scene: Scene) -> dict[str, list[str]]:
    """What the columns of MuJoCo's qpos, qvel and ctrl are, by what they hold."""
    single, floating = joints_of(scene)
    joints: list[Single | Floating] = sorted([*single, *floating], key=lambda joint: joint.qadr)
    return {
        "position": [
            f"{j.name}.{x}" for j in joints for x in (j.position if isinstance(j, Floating) else ["position"])
        ],
        "velocity": [
            f"{j.name}.{x}" for j in joints for x in (j.velocity if isinstance(j, Floating) else ["velocity"])
        ],
        "control": [f"{name}.control" for name in scene.actuator_names],
    }


def arrays(columns: Iterable[str]) -> dict[str, list[str]]:
    """The columns of each array without names for them, by its name."""
    found: dict[str, list[str]] = {}
    for column in columns:
        match = UNNAMED.fullmatch(column) or _NUMBERED.fullmatch(column)
        found.setdefault(match["array"] if match else column, []).append(column)
    return found


def _holding(quantity: str, count: int, given: Mapping[str, str], columns: Collection[str], scene: Scene) -> str | None:
    """The array of ``count`` columns that holds a whole ``quantity``: as was said, or by its name if nothing was said.

    What is said of robots without free and ball joints, and of controls, goes by joints (``whole_arrays``).
    """
    fitting = [name for name, parts in arrays(columns).items() if len(parts) == count]
    if any(text.partition(":")[0].strip() == quantity for text in given.values()):
        floats = joints_of(scene)[1] and quantity != "control"
        said = [name for name in fitting if given.get(name, "").partition(":")[0].strip() == quantity]
        return said[0] if said and floats else None
    called = [name for name in fitting if _CALLED.get(re.split(r"[./]", name)[-1]) == quantity and name not in given]
    return called[0] if len(called) == 1 else None
