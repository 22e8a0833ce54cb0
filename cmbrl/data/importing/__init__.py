"""Logs of others, as they are: read, their columns found, brought to a grid, checked, and written as logs of ours."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from cmbrl.data.drive import scene_of
from cmbrl.data.importing import build, kept, velocities
from cmbrl.data.importing.base import capture as base
from cmbrl.data.importing.base import feet, whereabouts
from cmbrl.data.importing.bodies import PLACE, joints_of
from cmbrl.data.importing.build import Frames
from cmbrl.data.importing.columns import state, whole_arrays
from cmbrl.data.importing.columns.targets import Target, match
from cmbrl.data.importing.columns.untold import assumed
from cmbrl.data.importing.commands import compensation, controls, measured_gains
from cmbrl.data.importing.commands.commanded import Commanded, idle
from cmbrl.data.importing.commands.gains import gains_of
from cmbrl.data.importing.grid import Counts, Key, Series, to_grid, usual_step
from cmbrl.data.importing.options import Options
from cmbrl.data.importing.readers.of_path import read
from cmbrl.data.importing.recording import Recording
from cmbrl.data.importing.series import clocks_of, series_of
from cmbrl.data.importing.tied import followers
from cmbrl.data.importing.told import UNUSED, no_column, not_read, short, told
from cmbrl.data.position_log import PositionLog, free_joint
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.info.columns import counted

__all__ = ["Frames", "Imported", "Options", "import_logs"]


@dataclass(frozen=True)
class Imported:
    """The log, and sentences on what was done to get it."""

    log: Transitions | PositionLog
    notes: tuple[str, ...]


def import_logs(paths: Sequence[str | os.PathLike[str]], scene: Scene, options: Options | None = None) -> Imported:
    """One log of ``scene`` from several files, one episode or more from each.

    Raises UserError that names the file for what cannot be read or understood, and for faults that its numbers show.
    """
    options = options or Options()
    options.check()
    recordings = [recording for path in paths for recording in read(path, tuple(options.joints))]
    poses = [recording for path in options.base for recording in read(path)]
    if poses and len(poses) != len(recordings):
        raise UserError(f"{len(recordings)} logs and {len(poses)} of the base: give one file of the base for each log")
    options, state_told = state.resolved(options, recordings[0], scene)
    counts = Counts()
    series, read_as, columns, slower = _series(recordings, poses, scene, options, counts)
    masters = [key for key in series[0][1] if key[1] == "position"] or list(series[0][1])
    step = usual_step([found[key] for _, found in series for key in masters])
    dt = 1 / options.rate if options.rate else step
    if not 1e-5 < dt < 10:
        raise UserError(
            f"{series[0][0]}: samples are {dt:.4g} s apart: is the unit of time right? Give it by --map COLUMN=time:ms "
            "(s, ms, us, ns)"
        )
    episodes: Sequence[build.Episode] = [
        one for _, found in series for one in to_grid(found, masters, dt, options.gap, counts)
    ]
    if not episodes:
        raise UserError(
            "no stretch of the log has all columns at once; check their times (and --command-offset), or give a larger "
            "--gap"
        )
    episodes, by_feet = whereabouts.by_feet(episodes, dt, scene, options.kind)
    captured = bool(poses or slower) and build.one_base(scene)  # of several bodies, transitions hold all
    if (captured and options.kind != "transitions") or options.markers is not None:
        episodes, moved = whereabouts.of_markers(episodes, dt, scene, options.markers)
        columns += moved
    keys = set(episodes[0])
    if without := idle(keys, scene):
        columns.append(f"commands of {short(without, 3)} are left out: no actuator of the file takes them")
    if options.compensated:
        episodes, held = compensation.added(episodes, scene)
        columns += held
    gains_told = options.kp is not None or options.kd is not None
    if options.kind == "transitions" and gains_told:
        raise UserError("transitions have no place for kp and kd: write them into the file, or import positions")
    gains_told |= any(name.partition(".")[0] in ("kp", "kd") for name in recordings[0].constants)
    kind = options.kind or ("positions" if captured or by_feet else _kind(keys, scene, gains_told))
    late = velocities.lagging(episodes, dt, scene) if kind == "transitions" and not options.kind else ""
    if late and build.one_base(scene) and Commanded.of(keys, scene):
        kind = "positions"
        columns.append(
            f"velocities of {late}, as a driver's filter or differences of positions do: the log has positions and "
            "commands alone; --as transitions keeps velocities"
        )
    columns = [*kept.columns_told(read_as, keys, kind, scene, without), *columns]
    sizes = f"{counted(len(episodes), 'episode')} from {counted(len(paths), 'file')}"
    notes = [f"{sizes}, a sample every {dt:.6g} s", *told(counts, options.gap), *columns, *state_told, *by_feet]
    log: Transitions | PositionLog
    if kind == "positions":
        commanded = Commanded.of(keys, scene)
        gains = gains_of(options.kp, options.kd, recordings[0], commanded, scene)
        gains, by_torques = measured_gains.beside(gains, episodes, dt, commanded, scene)
        notes += by_torques
        log = build.positions(episodes, dt, scene, commanded, gains, place_told=not by_feet)
        scene_of(log, scene)  # a motor that got targets needs the gains of its servo
    else:
        if wanted := controls.undriven(keys, scene):
            raise UserError(
                f"{series[0][0]}: {wanted}{''.join(f'; {note}' for note in columns if note.startswith(UNUSED))}"
                f"{not_read(recordings[0])}"
            )
        source: dict[str, Any] = {"imported": [str(path) for path in paths]}
        log, estimated = build.transitions(episodes, dt, scene, options.frames, options.window, source)
        if estimated:
            half = options.window // 2
            notes.append(
                f"velocities of {short(estimated, 3)} are estimated: central differences over a Savitzky-Golay window "
                f"of {options.window} samples (a parabola), one-sided beside impacts; {half} samples at each end of an "
                "episode are left out"
            )
    log.check(scene)
    return Imported(log, tuple(notes))


def _series(
    recordings: Sequence[Recording], poses: Sequence[Recording], scene: Scene, options: Options, counts: Counts
) -> tuple[list[tuple[str, dict[Key, Series]]], kept.ReadAs, list[str], bool]:
    """The series of each episode and where it is from, what columns are, notes, and whether poses come more slowly."""
    first: kept.ReadAs = ((), {})
    found: list[tuple[str, dict[Key, Series]]] = []
    notes: list[str] = []
    clocks: list[str] = []
    matched: list[tuple[Recording, dict[str, Target]]] = []
    mapped: dict[str, str] = {}
    offsets = options.command_offsets(len(recordings))
    for recording, pose, late in zip_longest(recordings, poses, offsets):
        parts = [[name for table in part.tables for name in table.columns] for part in (recording, pose) if part]
        columns = [name for part in parts for name in part]
        given = whole_arrays.by_column(options.columns, columns, scene)
        if unknown := [name for name in given if name not in columns]:
            match(columns, {unknown[0]: given[unknown[0]]}, scene)  # names the nearest
        given |= base.mapping_of(columns, given, options.quaternion, recording.where) if _floats(scene) else {}
        targets: dict[str, Target] = {}
        for part in parts:  # each has a time of its own
            targets |= match(part, {name: given[name] for name in part if name in given}, scene, options.angles)
        targets |= clocks_of(recording, targets)
        notes += [x for x in _told_by_readers(recording, targets) if x not in notes]
        matched.append((recording, targets))
        mapped |= given
        first = first if first[0] else (columns, targets)
        episodes = [
            {key: one.earlier(late) if one.kind == "held" else one for key, one in series.items()}
            for series in series_of(recording, targets, options.rate, scene, options.frames, counts)
        ]
        if pose:
            captures = list(series_of(pose, targets, None, scene, options.frames, counts))
            if len(captures) != len(episodes):
                raise UserError(
                    f"{pose.where}: {len(captures)} episodes, {recording.where} has {len(episodes)}: give as many"
                )
            for k, capture in enumerate(captures):
                both = episodes[k] | capture  # what lacks is told before the clocks, which take longer
                _check_whole(both | followers(both, scene)[0], recording, columns, targets, scene)
                frame = options.frames.angular
                episodes[k], note = base.synchronised(
                    episodes[k], capture, scene, options.base_offset, frame, pose.where
                )
                clocks += [note] if note not in clocks else []
        for k, one in enumerate([] if pose else episodes):
            between, note = base.at_joints(one, scene, recording.where)
            episodes[k] = one | between
            clocks += [note] if note and note not in clocks else []
        for series in episodes:
            tied, follows = followers(series, scene)
            series |= tied
            notes += [note for note in follows if note not in notes]
            _check_whole(series, recording, columns, targets, scene)
            if found and set(series) != set(found[0][1]):
                other = sorted(".".join(key) for key in set(series) ^ set(found[0][1]))[0]
                raise UserError(
                    f"{recording.where}: has other columns than {found[0][0]} ({other} is in one of them only): two "
                    "robots? Import logs of one robot, recorded alike"
                )
            found.append((recording.where, series))
    return found, first, notes + assumed(matched, mapped, scene, options.angles) + clocks, bool(clocks)


def _told_by_readers(recording: Recording, targets: Mapping[str, Target]) -> list[str]:
    """What a reader has left out, and what names of columns have made of them."""
    told = [f"{recording.where}: {note}" for note in recording.notes]
    return told + [f"{column} is taken {target.told}" for column, target in targets.items() if target.told]


def _check_whole(
    series: Mapping[Key, Series],
    recording: Recording,
    columns: Sequence[str],
    targets: Mapping[str, Target],
    scene: Scene,
) -> None:
    """Raises UserError where no column tells a joint, or the place of a base that does not stand on its feet."""
    standing = feet.told_by_feet(set(series), scene)
    places = [f"{standing.name}.{x}" for x in PLACE] if standing else []
    if missing := [name for name in build.lacking(set(series), scene) if name not in places]:
        told = no_column(missing[0], columns, targets, series, scene)
        raise UserError(f"{recording.where}: {told}{not_read(recording)}")


def _floats(scene: Scene) -> bool:
    return bool(joints_of(scene)[1])


def _kind(keys: set[Key], scene: Scene, gains_told: bool) -> str:
    """Transitions where all velocities were logged, or where a position log cannot hold what was.

    Velocities that an import estimates from positions have their noise, and a fit takes them for measured: positions
    alone tell delays, friction and masses better, also of a robot that floats.

    Only a position log holds the gains of servos; where the log or the user tells them, they may not be the file's.
    Nor do transitions hold joints that closed loops tell, such as the rods of a delta robot, whose ball joints float
    no base. Tossed bodies are told better by transitions, whose velocities look at no impact from its other side.
    """
    if build.looped(keys, scene):
        return "positions"
    commanded = Commanded.of(keys, scene)
    if gains_told and commanded and commanded.kind == "position":
        return "positions"
    swings = scene.nu == 0 and free_joint(scene) is None and not controls.undriven(keys, scene)
    held = build.one_base(scene) and (commanded is not None or swings)
    return "positions" if held and not build.velocities_known(keys, scene) else "transitions"
