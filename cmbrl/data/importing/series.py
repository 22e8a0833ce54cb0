"""Recordings as series of a scene's quantities: columns found, units converted, times told, episodes apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.importing.bodies import QUATERNION, TURN, joints_of
from cmbrl.data.importing.columns.targets import Target
from cmbrl.data.importing.grid import Counts, Key, Series, clean
from cmbrl.data.importing.lost import VELOCITIES, believable, without_lost
from cmbrl.data.importing.recording import Recording, Table
from cmbrl.data.turns import Hinge, going_on, hinges
from cmbrl.errors import UserError
from cmbrl.scene import Scene

if TYPE_CHECKING:
    from cmbrl.data.importing.build import Frames

HELD = ("command", "torque", "control")
_SHARED = 0.3  # of the rows that have the time of the next one, and tell something else
_PAUSE = 5.0  # times the usual tick of a clock: a gap


def series_of(
    recording: Recording,
    targets: Mapping[str, Target],
    rate: float | None,
    scene: Scene,
    frames: Frames,
    counts: Counts,
) -> Iterator[dict[Key, Series]]:
    """The series of each episode in a recording, by owner and quantity, in SI units.

    Raises UserError where times are missing or fall back.
    """
    episodes: dict[float, list[tuple[Table, np.ndarray]]] = {}
    for table in recording.tables:
        time = _time(recording, table, targets, rate)
        if table.time is None:
            time = _spread(recording.where, table, time, targets, counts)
        number = next(
            (table.columns[c] for c, t in targets.items() if t.quantity == "episode" and c in table.columns), None
        )
        if number is None:
            episodes.setdefault(0.0, []).append((table, time))
            continue
        for value in np.unique(number[np.isfinite(number)]):
            rows = number == value
            part = Table({name: column[rows] for name, column in table.columns.items()})
            episodes.setdefault(float(value), []).append((part, time[rows]))
    for value, parts in episodes.items():
        where = recording.where if len(episodes) == 1 else f"{recording.where} episode {value:g}"
        found: dict[Key, Series] = {}
        for table, time in parts:
            found.update(_of_table(where, table, time, targets, scene, counts))
        columns = {target.key: column for column, target in targets.items()}
        yield found | believable(found, columns, frames, counts)


def clocks_of(recording: Recording, targets: Mapping[str, Target]) -> dict[str, Target]:
    """The only column of dates, whatever it is called, where ``targets`` tell no time."""
    if any(target.quantity == "time" for target in targets.values()) or len(recording.dates) != 1:
        return {}
    return {} if recording.dates[0] in targets else {recording.dates[0]: Target("", "time")}


def _time(recording: Recording, table: Table, targets: Mapping[str, Target], rate: float | None) -> np.ndarray:
    """Times [s] of the rows of a table."""
    if table.time is not None:
        return table.time
    for column, target in targets.items():
        if target.quantity == "time" and column in table.columns:
            return table.columns[column].astype(np.float64) * target.factor
    rows = len(next(iter(table.columns.values())))
    if rate is None and "dt" not in recording.constants:
        raise UserError(
            f"{recording.where}: no column of times for {next(iter(table.columns))!r}; name it by --map "
            "COLUMN=time:UNIT, or give --rate HZ"
        )
    step = 1 / rate if rate is not None else float(recording.constants["dt"].item())
    times = np.arange(rows) * step
    number = next(
        (table.columns[c] for c, t in targets.items() if t.quantity == "episode" and c in table.columns), None
    )
    if number is not None:  # each episode begins anew; its rows stand together
        first = np.concatenate([[0], np.flatnonzero(np.diff(number)) + 1])
        times -= np.repeat(times[first], np.diff(np.concatenate([first, [rows]])))
    return times


def _spread(where: str, table: Table, time: np.ndarray, targets: Mapping[str, Target], counts: Counts) -> np.ndarray:
    """Times of rows that were stamped with too few digits, or by a clock that ticks more slowly: evenly between stamps.

    Rows of one time that tell the same, or each another column, are left as they are.
    """
    same = np.concatenate([time[1:] == time[:-1], [False]])
    told = [table.columns[c].astype(np.float64) for c, t in targets.items() if t.owner and c in table.columns]
    if not told or same.mean() < _SHARED:
        return time
    values = np.column_stack(told)
    with np.errstate(invalid="ignore"):
        other = (
            np.abs(np.diff(values, axis=0)).max(axis=1, initial=0.0, where=np.isfinite(np.diff(values, axis=0))) > 0.0
        )
    if (same[:-1] & other).mean() < _SHARED:
        return time
    first = np.flatnonzero(np.concatenate([[True], time[1:] != time[:-1]]))  # rows at which the stamp changes
    ticks = np.diff(time[first])
    breaks = np.flatnonzero((ticks > _PAUSE * np.median(ticks)) | (ticks < 0.0)) + 1
    out = time.astype(np.float64)
    for part in np.split(first, breaks):
        end = int(np.append(first[first > part[-1]], len(time))[0])
        if len(part) > 2:  # the first and the last stamp may have lost rows
            slope, begin = np.polyfit(part[1:] - part[0], time[part[1:]], 1)
            out[part[0] : end] = begin + slope * np.arange(end - part[0])
            counts.spread[where] = float(slope)
    return out


def _of_table(
    where: str, table: Table, time: np.ndarray, targets: Mapping[str, Target], scene: Scene, counts: Counts
) -> Iterator[tuple[Key, Series]]:
    single, floating = joints_of(scene)
    known = hinges(scene)
    turning = {joint.name: known[joint.vadr] for joint in single if joint.hinge}
    named = {targets[column].key: column for column in table.columns if column in targets}
    for joint in floating:
        parts = [named.pop((joint.name, name), None) for name in TURN]
        if all(parts):
            values = np.column_stack([table.columns[str(column)] for column in parts])
            key = (joint.name, QUATERNION)
            yield key, clean(joint.name, where, time, values.astype(np.float64), "turn", counts)
        elif any(parts):
            raise UserError(
                f"{where}: joint {joint.name!r} needs all of {', '.join(TURN)} in one table; map the others"
            )
    for key, column in named.items():
        owner, quantity = key
        if not owner:
            continue
        target = targets[column]
        values = table.columns[column].astype(np.float64)[:, None] * target.factor + target.zero
        one = clean(column, where, time, values, "held" if quantity in HELD else "line", counts)
        if owner in turning and (quantity == "position" or (quantity == "command" and turning[owner].limited)):
            one = _going_on(column, one, turning[owner], counts)
        yield key, one if quantity in VELOCITIES else without_lost(column, one, counts)


def _going_on(column: str, one: Series, hinge: Hinge, counts: Counts) -> Series:
    """The series of a column of angles with whole turns added where it begins again after one."""
    whole = going_on(one.values[:, 0], np.zeros(len(one.time)), hinge)[:, None]
    jumps = int((np.abs(np.diff(one.values - whole, axis=0)) > 1).sum())
    counts.turns[column] = counts.turns.get(column, 0) + jumps
    return Series(one.time, whole, one.kind)
