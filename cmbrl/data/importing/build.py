"""Logs from episodes on a grid: transitions where velocities are known or estimated, else a position log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.data.importing.bodies import ANGULAR, LINEAR, PLACE, QUATERNION, Floating, joints_of
from cmbrl.data.importing.commands.commanded import Commanded, wanted
from cmbrl.data.importing.commands.controls import controls
from cmbrl.data.importing.grid import Key
from cmbrl.data.importing.velocities import check_frame, in_frame, smoothed
from cmbrl.data.loops import closed, closing
from cmbrl.data.position_log import PositionLog
from cmbrl.data.trajectories import read_trajectories
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.scene import Scene

Episode = Mapping[Key, np.ndarray]


@dataclass(frozen=True)
class Frames:
    """Axes in which the velocities of floating bases were logged: "body" or "world"; None: not told."""

    angular: str | None = None
    linear: str = "world"


def lacking(keys: set[Key], scene: Scene) -> list[str]:
    """Positions that ``keys`` do not have, and closed loops do not tell, as the user would map them."""
    single, floating = joints_of(scene)
    looped = closing(scene, _told(keys, scene))
    unknown = [joint for joint in single if (joint.name, "position") not in keys]
    missing = [f"{joint.name}.position" for joint in unknown if joint.vadr not in looped]
    for joint in (each for each in floating if each.vadr not in looped):
        missing += [f"{joint.name}.{x}" for x in PLACE if joint.free and (joint.name, x) not in keys]
        missing += [f"{joint.name}.qw to qz"] * ((joint.name, QUATERNION) not in keys)
    return missing


def one_base(scene: Scene) -> bool:
    """Whether nothing floats or swivels but at most one base, so that a position log holds all of it."""
    floating = joints_of(scene)[1]
    return len(floating) <= 1 and all(joint.free for joint in floating)


def looped(keys: set[Key], scene: Scene) -> bool:
    """Whether closed loops tell joints that ``keys`` do not."""
    return bool(closing(scene, _told(keys, scene)))


def _told(keys: set[Key], scene: Scene) -> list[int]:
    """Places in v of the joints, but free ones, whose positions are among ``keys``."""
    single, floating = joints_of(scene)
    turned = [joint.vadr for joint in floating if not joint.free and (joint.name, QUATERNION) in keys]
    return [joint.vadr for joint in single if (joint.name, "position") in keys] + turned


def velocities_known(keys: set[Key], scene: Scene) -> bool:
    """Whether the velocities of all joints are among ``keys``."""
    single, floating = joints_of(scene)
    wanted = [(joint.name, "velocity") for joint in single]
    wanted += [(joint.name, name) for joint in floating for name in joint.velocity]
    return all(key in keys for key in wanted)


def positions(
    episodes: Sequence[Episode],
    dt: float,
    scene: Scene,
    commanded: Commanded | None,
    gains: Mapping[str, Any],
    place_told: bool = True,
) -> PositionLog:
    """The position log of ``episodes`` with what is ``commanded`` (None: nothing is driven).

    ``place_told``: whether the place of the base was measured.

    Raises UserError for ball joints, two floating bodies, or a missing command.
    """
    single, floating = joints_of(scene)
    looped = closing(scene, _told(set(episodes[0]), scene))
    single = [joint for joint in single if joint.vadr not in looped]
    floating = [joint for joint in floating if joint.vadr not in looped]
    if len(floating) > 1 or any(not joint.free for joint in floating):
        raise UserError(
            f"joint {floating[-1].name!r} is a ball or a second base, and a position log has one base; give --as "
            "transitions"
        )
    keys = set(episodes[0])
    if commanded is None and scene.nu:
        raise wanted(set(episodes[0]), scene)
    lengths = [len(next(iter(episode.values()))) for episode in episodes]
    whole = {key: np.concatenate([episode[key] for episode in episodes]) for key in keys}
    stacked = {key: values[:, 0] for key, values in whole.items()}
    poses = [np.column_stack([*(stacked[b.name, x] for x in PLACE), whole[b.name, QUATERNION]]) for b in floating]
    rows = sum(lengths)
    return PositionLog(
        time=np.concatenate([dt * np.arange(length) for length in lengths]),
        position=_columns([stacked[joint.name, "position"] for joint in single], rows),
        command=_columns([stacked[key] * x for key, x in zip(commanded.keys, commanded.factors, strict=True)], rows)
        if commanded
        else np.zeros((rows, 0)),
        joint_names=tuple(joint.name for joint in single),
        command_kind=commanded.kind if commanded else "position",
        episode=np.repeat(np.arange(len(lengths)), lengths),
        actuator_names=commanded.names if commanded else (),
        base=poses[0] if poses else None,
        place_told=place_told,
        **gains,
    )  # fmt: skip


def _columns(columns: Sequence[np.ndarray], rows: int) -> np.ndarray:
    return np.column_stack(columns) if columns else np.zeros((rows, 0))


def transitions(
    episodes: Sequence[Episode], dt: float, scene: Scene, frames: Frames, window: int, source: dict[str, Any]
) -> tuple[Transitions, list[str]]:
    """Transitions of ``episodes``, and the joints whose velocities were estimated over ``window`` samples.

    Raises UserError for velocities in no or the wrong frame, missing controls, and episodes that are too short.
    """
    told, (single, floating) = _told(set(episodes[0]), scene), joints_of(scene)
    inner = [(joint.name, joint.vadr) for joint in single]
    inner += [(joint.name, joint.vadr) for joint in floating if not joint.free]
    untold = [name for name, place in inner if place not in told]
    if untold:
        raise UserError(
            f"no column for {untold[0]}.position, which closed loops tell in a position log only: give --as positions, "
            "or map a column"
        )
    half = window // 2
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    estimated: list[str] = []
    for episode in episodes:
        q, u = configurations(episode, scene), controls(episode, scene)
        if len(q) < window + 2:
            continue
        smooth = smoothed(q, dt, window, scene)
        inside = slice(half, len(q) - half)
        v, estimated = _velocities({key: x[inside] for key, x in episode.items()}, smooth, q[inside], scene, frames)
        if not estimated:  # then the ends are as good as the middle
            v, _ = _velocities(episode, np.zeros((len(q), scene.nv)), q, scene, frames, check=False)
            inside = slice(None)
        parts.append((q[inside], v, u[inside]))
    if not parts:
        raise UserError(f"every episode is shorter than {window + 2} samples; give longer logs or a larger --gap")
    q, v, u = (np.concatenate(part) for part in zip(*parts, strict=True))
    log = read_trajectories(
        q, [len(part[0]) for part in parts], dt, v, u, scene.difference,
        joint_names=scene.joint_names, actuator_names=scene.actuator_names, source=source,
    )  # fmt: skip
    return log, estimated


def configurations(episode: Episode, scene: Scene) -> np.ndarray:
    """q (T, nq) of ``episode``; a base whose place was not logged is at 0, and what loops tell is where they close."""
    single, floating = joints_of(scene)
    looped = closing(scene, _told(set(episode), scene))
    q = np.zeros((len(next(iter(episode.values()))), scene.nq))
    for joint in (each for each in single if each.vadr not in looped):
        q[:, joint.qadr] = episode[joint.name, "position"][:, 0]
    for base in floating:
        turn = base.position["qw"]
        q[:, turn : turn + 4] = [1.0, 0.0, 0.0, 0.0] if base.vadr in looped else episode[base.name, QUATERNION]
        for name in PLACE if base.free and (base.name, PLACE[0]) in episode else ():
            q[:, base.position[name]] = episode[base.name, name][:, 0]
    return closed(scene, q, looped) if looped else q


def _velocities(
    episode: Episode, smooth: np.ndarray, q: np.ndarray, scene: Scene, frames: Frames, check: bool = True
) -> tuple[np.ndarray, list[str]]:
    """Velocities as logged where they are, else those of ``smooth``; and the names of the joints of the latter."""
    single, floating = joints_of(scene)
    v, estimated = smooth.copy(), []
    for joint in single:
        if (joint.name, "velocity") in episode:
            v[:, joint.vadr] = episode[joint.name, "velocity"][:, 0]
        else:
            estimated.append(joint.name)
    for base in floating:
        turn = q[:, base.position["qw"] : base.position["qw"] + 4]
        for what, names in (("linear", LINEAR if base.free else ()), ("angular", ANGULAR)):
            if not names:
                continue
            if any((base.name, name) not in episode for name in names):
                estimated.append(f"{base.name} ({what})")
                continue
            given = np.column_stack([episode[base.name, name][:, 0] for name in names])
            v[:, _places(base, names)] = _framed(base, what, given, smooth, turn, frames, check)
    return v, estimated


def _places(base: Floating, names: tuple[str, ...]) -> list[int]:
    return [base.velocity[name] for name in names]


def _framed(
    base: Floating, what: str, given: np.ndarray, smooth: np.ndarray, turn: np.ndarray, frames: Frames, check: bool
) -> np.ndarray:
    """Logged velocities in MuJoCo's frames: linear of the world, angular of the body."""
    linear = what == "linear"
    frame = frames.linear if linear else frames.angular
    told = smooth[:, _places(base, LINEAR if linear else ANGULAR)]
    if check:
        check_frame(base.name, what, frame, given, in_frame("body", "world", turn, told) if linear else told, turn)
    return in_frame("world" if linear else "body", str(frame), turn, given)
