"""Units that a format leaves open: LeRobot's columns are radians, degrees, or shares of a joint's calibrated range.

Its drivers normalise to -100 to 100 (grippers to 0 to 100) or to degrees as they are set, simulators write radians, and
the dataset does not say. Radians show: the others lie far beyond the limits of the file. Degrees and shares look alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.importing.columns.targets import Target
from cmbrl.data.importing.columns.units import TURN_UNITS
from cmbrl.data.importing.recording import Recording
from cmbrl.errors import UserError
from cmbrl.scene import Scene

_FAR = 3.0  # times the limits of the file
_FULL = 101.0  # the most that a share of a range reaches, with some room
_GRIPPERS = ("grip", "jaw", "finger")


def assumed(
    recordings: Iterable[tuple[Recording, Mapping[str, Target]]], given: Mapping[str, str], scene: Scene, angles: str
) -> list[str]:
    """Notes on the unit of hinges that were found by name in recordings without units; none where all were told.

    ``angles``: the unit that they were read in. Raises UserError where that is radians and no limits allow for it.
    """
    reach = _reaches(recordings, given, scene, TURN_UNITS[angles])
    if not reach:
        return []
    lines, core = scene.core.lim_line.tolist(), scene.core
    beyond = []
    for column, (joint, least, most) in reach.items():
        if joint.vadr not in lines:
            continue
        low, high = (float(x[lines.index(joint.vadr)]) for x in (core.lim_lo, core.lim_hi))
        most_of_radians = max(_FAR * max(abs(low), abs(high)), 2 * np.pi)  # another zero moves a joint less
        if angles == "rad" and max(abs(least), abs(most)) > most_of_radians:
            beyond.append((column, joint.name, least, most, low, high))
    shares = all(least >= -_FULL and most <= _FULL for _, least, most in reach.values())
    if beyond and shares:
        column, name, least, most, low, high = max(beyond, key=lambda one: one[3] - one[2])
        raise UserError(
            f"{column!r} goes from {least:.4g} to {most:.4g}, joint {name!r} from {low:.3g} to {high:.3g} rad, and "
            "LeRobot does not tell units: degrees (give --angles deg), or shares of the range (give --map "
            f"COLUMN={name}.position:+-percent for each, grippers :percent)?"
        )
    columns = f"{len(reach)} hinges" if len(reach) > 1 else next(iter(reach))
    notes = [f"{columns} of LeRobot, which tells no units, are taken in {angles}"]
    notes += [
        f"{column} goes from {least:.4g} to {most:.4g} and is taken in deg; if it is 0 to 100 of the range, as "
        f"LeRobot's drivers write grippers, give --map {column}={joint.name}.position:percent, and so for its command"
        for column, (joint, least, most) in reach.items()
        if angles == "deg" and least >= -0.01 * _FULL and any(word in column.lower() for word in _GRIPPERS)
    ]
    return notes


def _reaches(
    recordings: Iterable[tuple[Recording, Mapping[str, Target]]], given: Mapping[str, str], scene: Scene, factor: float
) -> dict[str, tuple]:
    """By column of a position whose name has no unit: the hinge, the least and the most of it in all recordings.

    ``factor``: of columns without one.
    """
    hinges = {joint.name: joint for joint in joints_of(scene)[0] if joint.hinge}
    found: dict[str, tuple] = {}
    for recording, targets in recordings:
        for table in () if recording.tells_units else recording.tables:
            for column, target in targets.items():
                known = column in table.columns and column not in given and target.quantity == "position"
                if not known or target.owner not in hinges or target.factor != factor:
                    continue
                values = np.asarray(table.columns[column], dtype=float)
                if not np.isfinite(values).any():
                    continue
                _, least, most = found.get(column, (None, np.inf, -np.inf))
                ends = min(least, float(np.nanmin(values))), max(most, float(np.nanmax(values)))
                found[column] = (hinges[target.owner], *ends)
    return found
