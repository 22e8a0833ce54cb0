"""What an import says: which columns it used, what it changed, and what a log lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.importing.grid import Counts, Key, Series
from cmbrl.scene import Scene

UNUSED = "not used"


def short(names: Sequence[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def plural(count: int, word: str) -> str:
    return f"{count} {word}{'s' * (count != 1)}"


def used(columns: Sequence[str], targets: Mapping[str, str]) -> list[str]:
    by: dict[str, list[str]] = {}
    for column, target in targets.items():
        by.setdefault(target.rpartition(".")[2], []).append(f"{column} = {target}")
    notes = [f"{quantity}: {short(pairs, 3)}" for quantity, pairs in by.items()]
    if unused := [name for name in columns if name not in targets]:
        notes.append(f"{UNUSED}: {short(unused)}")
    return notes


def hold(series: Mapping[Key, Series], scene: Scene) -> str:
    """The other remedy where the log tells some joints and leaves out others."""
    names = [joint.name for joint in joints_of(scene)[0]]
    absent = [name for name in names if (name, "position") not in series]
    if not absent or len(absent) == len(names):
        return ""
    return f", or hold what no log tells: `cmbrl convert FILE.xml HELD.xml {' '.join(f'--hold {x}' for x in absent)}`"


def told(counts: Counts, gap: int) -> list[str]:
    notes = []
    if counts.resampled:
        notes.append(
            f"{counts.resampled} of {counts.samples} samples were resampled to a regular grid, {counts.lost} of them "
            "were lost (positions linearly, quaternions by slerp, commands held)"
        )
    if repeated := sum(counts.repeated.values()):
        notes.append(f"{plural(repeated, 'sample')} that repeat a time were dropped")
    if counts.gaps:
        notes.append(f"{plural(counts.gaps, 'gap')} of more than {gap} samples, where an episode ends")
    if counts.short:
        notes.append(f"{counts.short} samples between gaps were too few for an episode")
    for column, turns in counts.turns.items():
        if turns:
            notes.append(f"{column} goes on where it jumped by a whole turn ({turns} times)")
    return notes
