"""What an import says: which columns it used, what it changed, and what a log lacks."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, TURN, Floating, joints_of
from cmbrl.data.importing.columns import whole_arrays
from cmbrl.data.importing.columns.targets import Target
from cmbrl.data.importing.grid import Counts, Key, Series
from cmbrl.data.importing.recording import Recording
from cmbrl.data.loops import to_hold
from cmbrl.scene import Scene
from cmbrl.scene.info.columns import counted
from cmbrl.scene.writing.held import holding

UNUSED = "not used"
_OF_BASES = dict.fromkeys((*PLACE, *TURN), "pose") | dict.fromkeys((*LINEAR, *ANGULAR), "velocity")


def short(names: Sequence[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def used(columns: Sequence[str], targets: Mapping[str, Target], dropped: Collection[str], why: str) -> list[str]:
    """What ``columns`` are taken for; those ``dropped`` are understood, and are not in the log for the reason ``why``.

    >>> used(["a", "b", "c"], {"a": Target("hip", "position"), "b": Target("hip", "velocity")}, ["b"], "no place")
    ['position: a = hip.position', 'not in the log: velocity (b): no place', 'not used: c']
    """
    held: dict[str, list[str]] = {}
    left: dict[str, list[str]] = {}
    for column, target in targets.items():
        quantity = _OF_BASES.get(target.quantity, target.quantity)
        if column in dropped:
            left.setdefault(quantity, []).append(column)
        else:
            held.setdefault(quantity, []).append(f"{column} = {'.'.join(filter(None, target.key))}")
    notes = [f"{quantity}: {short(pairs, 3)}" for quantity, pairs in held.items()]
    if left:
        parts = [f"{quantity} ({short(names, 3)})" for quantity, names in left.items()]
        notes.append(f"not in the log: {', '.join(parts)}: {why}")
    if unused := [name for name in columns if name not in targets]:
        notes.append(f"{UNUSED}: {short(unused)}")
    return notes


def no_column(
    wanted: str, columns: Sequence[str], targets: Mapping[str, Any], series: Mapping[Key, Series], scene: Scene
) -> str:
    """That nothing of a log is ``wanted``, such as ``knee.position``, and what to do; ``targets``: columns in use."""
    word = wanted.partition(" ")[0]
    unused = [column for column in columns if column not in targets]
    return (
        f"no column for {wanted}{_resembling(word.rpartition('.')[0], unused, scene)}: map one by --map COLUMN={word}"
        f"{whole_arrays.hint(columns, targets, scene)}{_remedy(wanted, series, scene)}; "
        f"columns: {short([*unused, *targets])}"
    )


def _resembling(joint: str, unused: Sequence[str], scene: Scene) -> str:
    """A question that names the column whose label is nearly ``joint``: a slip in a header, or in --joints."""
    owners = {*scene.joint_names, *scene.actuator_names}
    labels = {column.rpartition(".")[2]: column for column in reversed(unused)}
    near = difflib.get_close_matches(joint, labels.keys() - owners, n=1, cutoff=0.8)
    return f" (is it {labels[near[0]]!r}?)" if near else ""


def _remedy(wanted: str, series: Mapping[Key, Series], scene: Scene) -> str:
    """What to do besides mapping, where the log tells some joints: hold the others, or give the poses of the base.

    Of a body alone of whose place something was logged, a single marker or a camera may be all there is.
    """
    single, floating = joints_of(scene)
    absent = [joint.name for joint in single if (joint.name, "position") not in series]
    if len(absent) == len(single):
        return ""
    if absent:
        known = [joint.vadr for joint in single if joint.name not in absent]
        absent = to_hold(scene, known) or absent
        return f", or hold what no log tells: `cmbrl convert FILE.xml HELD.xml {holding(absent, scene.joint_names)}`"
    if not any(base.free for base in floating):
        return ""
    name, _, lacks = wanted.rpartition(".")
    seen = any((name, axis) in series for axis in PLACE)
    marker = seen and lacks.startswith((*PLACE, TURN[0])) and _alone(name, floating, scene)
    slides = ", or, of a marker that tells no turn, give the body three slides instead of a free joint"
    option = holding([name], scene.joint_names)
    held = "" if seen else f", or, if it hangs or is mounted, hold it: `cmbrl convert FILE.xml HELD.xml {option}`"
    return f"{held}, or give a file of its poses by --base{slides if marker else ''}"


def _alone(name: str, floating: Sequence[Floating], scene: Scene) -> bool:
    """Whether the body of the free joint ``name`` carries no other."""
    places = [base.vadr for base in floating if base.name == name]
    bodies = scene.core.jnt_body[np.isin(scene.core.jnt_vadr, places)]
    return not np.isin(bodies, scene.core.body_parent).any()


def not_read(recording: Recording) -> str:
    """The topics of a bag whose types are not known, to end an error with; empty where there is none."""
    return f"; topics of types that are not read: {short(recording.unread, 4)}" if recording.unread else ""


def told(counts: Counts, gap: int) -> list[str]:
    notes = []
    if counts.resampled:
        notes.append(
            f"{counts.resampled} of {counts.samples} samples were resampled to a regular grid, {counts.lost} of them "
            "were lost (positions linearly, quaternions by slerp, commands held)"
        )
    if missing := [f"{n} of {column}" for column, n in counts.missing.items() if n]:
        what = "samples that are no numbers, or beyond 1e12, were filled in, or left out where many are"
        notes.append(f"{what}: {short(missing, 3)}")
    if alone := [
        f"{len(x)} of {column} ({x[0]:.4g}{' and others' * (len(x) > 1)})" for column, x in counts.stray.items()
    ]:
        notes.append(f"samples that stand alone, as no motion does, were taken for lost: {', '.join(alone)}")
    if late := [f"{n} of {column}" for column, n in counts.stale.items()]:
        notes.append(
            f"samples that repeat the last one, while what they tell moves on, were filled in: {', '.join(late)}"
        )
    if repeated := sum(counts.repeated.values()):
        notes.append(f"{counted(repeated, 'sample')} that repeat a time were dropped")
    for where, step in counts.spread.items():
        notes.append(
            f"{where}: several rows have each time, as of a clock with few digits: they are taken {step:.3g} s apart; "
            "leave the times out by --map COLUMN=- and give --rate HZ if you know it"
        )
    notes += [
        f"{where}: from {first:.4g} to {last:.4g} s after its start there are twice as many samples as elsewhere, as "
        "where a clock was set back: they are left out"
        for where, (first, last) in counts.laid_over.items()
    ]
    if counts.gaps:
        notes.append(f"{counted(counts.gaps, 'gap')} of more than {gap} samples, where an episode ends")
    if counts.short:
        notes.append(f"{counts.short} samples between gaps were too few for an episode")
    for column, turns in counts.turns.items():
        if turns:
            notes.append(f"{column} goes on where it jumped by a whole turn ({turns} times)")
    return notes
