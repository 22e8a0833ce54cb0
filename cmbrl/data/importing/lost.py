"""Series without lost readings: such that stand alone, and such that repeat the last one while it moves on.

Velocities do both of themselves, at impacts and in free flight: there positions have to contradict them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.contradicted import contradicted
from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, QUATERNION
from cmbrl.data.importing.grid import Counts, Key, Series, values_at
from cmbrl.data.importing.velocities import in_frame
from cmbrl.data.stale import stale
from cmbrl.data.stray import stray
from cmbrl.scene.manifold import rotation_between

if TYPE_CHECKING:
    from cmbrl.data.importing.build import Frames

VELOCITIES = ("velocity", *LINEAR, *ANGULAR)


def without_lost(column: str, one: Series, counts: Counts) -> Series:
    """The series of a ``column`` that is no velocity without readings that stand alone, the repeated ones filled in."""
    one = _without_stray(column, one, stray(one.values[:, 0], commanded=one.kind == "held"), counts)
    return one if one.kind == "held" else _without_stale(column, one, stale(one.values[:, 0]), counts)


def believable(
    found: Mapping[Key, Series], columns: Mapping[Key, str], frames: Frames, counts: Counts
) -> dict[Key, Series]:
    """The velocities among ``found`` by owner and quantity without those readings that positions contradict.

    ``columns``: their names. Where positions do not tell, those repeat the last one that do so with all velocities of
    their owner.
    """
    mended = {}
    for key in (key for key in found if key[1] in VELOCITIES):
        column, one = columns[key], found[key]
        lone = _contradicted(stray(one.values[:, 0]), one, key, found, frames)
        one = _without_stray(column, one, lone, counts)
        late = _contradicted(stale(one.values[:, 0]), one, key, found, frames, _all_repeat(one.time, key[0], found))
        mended[key] = _without_stale(column, one, late, counts)
    return mended


def _without_stray(column: str, one: Series, lone: np.ndarray, counts: Counts) -> Series:
    """``one`` without the readings that stand alone: what comes between them is filled in later."""
    if not lone.any():
        return one
    counts.stray.setdefault(column, []).extend(one.values[lone, 0].tolist())
    return Series(one.time[~lone], one.values[~lone], one.kind)


def _without_stale(column: str, one: Series, lost: np.ndarray, counts: Counts) -> Series:
    if not lost.any():
        return one
    counts.stale[column] = counts.stale.get(column, 0) + int(lost.sum())
    return _filled(one, lost)


def _filled(one: Series, lost: np.ndarray) -> Series:
    """``one`` with the ``lost`` readings on straight lines between those before and after them."""
    return replace(one, values=np.interp(one.time, one.time[~lost], one.values[~lost, 0])[:, None])


def _contradicted(
    lost: np.ndarray,
    one: Series,
    key: Key,
    found: Mapping[Key, Series],
    frames: Frames,
    untold: np.ndarray | None = None,
) -> np.ndarray:
    """Those of the ``lost`` readings (T,) of a velocity that its position contradicts; all where it has none."""
    if not lost.any() or (moved := _moved(one.time, key, found, frames)) is None:
        return lost
    v, mended = one.values[:, 0], _filled(one, lost).values[:, 0]
    return contradicted(lost, v, mended, moved, np.diff(one.time), untold)


def _moved(time: np.ndarray, key: Key, found: Mapping[Key, Series], frames: Frames) -> np.ndarray | None:
    """What the position of a velocity moves by from each ``time`` to the next (T - 1,), in the velocity's frame."""
    owner, quantity = key
    linear = quantity in LINEAR
    parts = ("position",) if quantity == "velocity" else PLACE if linear else (QUATERNION,)
    if any((owner, part) not in found for part in parts):
        return None
    told = np.hstack([values_at(found[owner, part], time) for part in parts])
    if quantity == "velocity":
        return np.asarray(np.diff(told[:, 0]))
    frame = frames.linear if linear else frames.angular or "body"
    axis = (LINEAR if linear else ANGULAR).index(quantity)
    if linear and frame == "world":
        return np.asarray(np.diff(told[:, axis]))
    if (owner, QUATERNION) not in found:
        return None
    turn = values_at(found[owner, QUATERNION], time)
    moved = np.diff(told, axis=0) if linear else rotation_between(turn[:-1], turn[1:])
    return in_frame(frame, "world" if linear else "body", turn[:-1], moved)[:, axis]


def _all_repeat(time: np.ndarray, owner: str, found: Mapping[Key, Series]) -> np.ndarray:
    """Mask (T,) of the times at which no velocity of ``owner`` changes."""
    repeats = np.ones(len(time), dtype=bool)
    for one in (one for (name, quantity), one in found.items() if name == owner and quantity in VELOCITIES):
        changes = one.time[1:][np.diff(one.values[:, 0]) != 0.0]
        repeats &= ~np.isin(time, changes)
    return repeats
