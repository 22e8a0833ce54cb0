"""The position log: joint positions and commands against time, no velocities. What an encoder and a driver tell."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cmbrl.data import checks, plausible, position_file, turns
from cmbrl.data.loops import closing, to_hold
from cmbrl.data.npz import read_arrays
from cmbrl.data.position_file import COMMANDS
from cmbrl.data.splitting import row_numbers
from cmbrl.data.ties import followers
from cmbrl.errors import UserError, did_you_mean
from cmbrl.files import write_bytes
from cmbrl.numbers import names, one_of, switch
from cmbrl.reading import regular_file
from cmbrl.scene.fittable.play import plays
from cmbrl.scene.records import JointKind
from cmbrl.scene.writing.held import holding

if TYPE_CHECKING:
    from cmbrl.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class PositionLog:
    """T samples of one robot. In row i, ``position[i]`` is measured at ``time[i]``; ``command[i]`` holds to row i + 1.

    Column k of ``command`` is for actuator ``actuator_names[k]``; without these names it is for the actuator of joint
    ``joint_names[k]``. It has no columns where nothing is driven. The rows of an episode are contiguous, and time rises
    within it by nearly equal steps. Construction checks shapes and values and raises :class:`cmbrl.UserError` that
    names the array and the row.
    """

    time: np.ndarray  #: (T,) [s]
    position: np.ndarray  #: (T, n) of hinges [rad] and slides [m]
    command: np.ndarray  #: (T, m) target of position servos [rad, m], torque [N m, N], or what each actuator takes
    joint_names: tuple[str, ...]  #: (n,) in the order of ``position``
    actuator_names: tuple[str, ...] = ()  #: (m,) in the order of ``command``; empty: the actuators of the joints
    command_kind: Literal["position", "torque", "control"] = "position"
    kp: np.ndarray | None = None  #: (m,) gain of the position servos [N m/rad, N/m]; None: that of the scene
    kd: np.ndarray | None = None  #: (m,) their gain of the velocity [N m s/rad, N s/m]; None: that of the scene
    episode: np.ndarray = None  # type: ignore[assignment]  #: (T,) int64, the episode of each row; None: all are one
    base: np.ndarray | None = None  #: (T, 7) of the only free joint: place in the world [m], quaternion w x y z
    place_told: bool = True  #: whether the place in ``base`` was measured; else it was estimated, and is not compared

    def __post_init__(self) -> None:
        one_of(self.command_kind, COMMANDS, "kind of command")
        key = COMMANDS[self.command_kind]
        position, command = checks.numbers("joint_position", self.position), checks.numbers(key, self.command)
        rows = len(position)
        if len(command) != rows:
            raise UserError(f"{key} has {len(command)} rows, joint_position has {rows}; give one row per sample")
        joints = checks.unique_names(self.joint_names, "joint_names", position.shape[1], "joint_position")
        actuators = names(self.actuator_names, "actuator_names")
        if actuators:
            checks.unique_names(actuators, "actuator_names", command.shape[1], key)
        elif command.shape[1] not in (0, len(joints)):  # none, of what hangs without a motor
            raise UserError(
                f"{key} has {command.shape[1]} columns for {len(joints)} joints; name its columns by actuator_names"
            )
        if self.base is not None:
            object.__setattr__(self, "base", checks.poses(self.base, rows))
        episode = np.zeros(rows) if self.episode is None else self.episode
        object.__setattr__(self, "place_told", switch(self.place_told, "place_told"))
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "command", command)
        object.__setattr__(self, "joint_names", joints)
        object.__setattr__(self, "actuator_names", actuators)
        object.__setattr__(self, "kp", checks.gains(self.kp, "kp", command.shape[1]))
        object.__setattr__(self, "kd", checks.gains(self.kd, "kd", command.shape[1]))
        if self.command_kind == "control" and (self.kp is not None or self.kd is not None):
            raise UserError("kp and kd beside control: controls act by the file's own laws; leave the gains out")
        object.__setattr__(self, "episode", checks.episodes(episode, rows))
        object.__setattr__(self, "time", checks.times(self.time, self.episode))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def dt(self) -> float:
        """The median time between two rows [s]."""
        return float(np.median(checks.time_steps(self.time, self.episode)[1]))

    @property
    def n_episodes(self) -> int:
        """Number of episodes."""
        return len(np.unique(self.episode))

    @property
    def command_names(self) -> tuple[str, ...]:
        """What the columns of ``command`` are called: actuators, or else joints."""
        return self.actuator_names or self.joint_names[: self.command.shape[1]]

    def select(self, rows: Any) -> PositionLog:
        """The rows of an index array, a mask (T,) or a slice; raises UserError where time steps become uneven."""
        chosen = row_numbers(rows, len(self))
        picked = {name: getattr(self, name)[chosen] for name in ("time", "position", "command", "episode")}
        return replace(self, **picked, base=None if self.base is None else self.base[chosen])

    def coordinates(self, scene: Scene) -> np.ndarray:
        """(n,) places in ``scene``'s v of the log's joints; raises UserError for a joint that the scene lacks."""
        known = {joint.name: joint for joint in scene.joints}
        for name in self.joint_names:
            if name not in scene.joint_names:
                raise UserError(
                    f"joint {name!r} of the log is not in scene {scene.name!r}: {did_you_mean(name, scene.joint_names)}"
                )
            if name not in known or known[name].kind == JointKind.BALL:
                raise UserError(f"joint {name!r} has no single position; a position log has hinges and slides")
        return np.array([known[name].vadr for name in self.joint_names], dtype=np.int64)

    def measured(self, scene: Scene) -> np.ndarray:
        """Which coordinates (nv,) of ``scene`` the log measured.

        Not the place of a base that was estimated, nor what follows from closed loops, nor a play without a column.
        """
        found = np.ones(scene.nv, dtype=bool)
        found[self.looped(scene)] = False
        found[[joint.vadr for joint in plays(scene.joints) if joint.name not in self.joint_names]] = False
        if not self.place_told and (name := free_joint(scene)):
            slides = [
                j for j in scene.joints if j.source == scene.joint_names.index(name) and j.kind == JointKind.SLIDE
            ]
            found[[joint.vadr for joint in slides]] = False
        return found

    def looped(self, scene: Scene) -> list[int]:
        """Places in ``scene``'s v of the joints that closed loops tell beside those of the log."""
        told = self.coordinates(scene).tolist()
        return closing(scene, [*told, *(place for place, _, _ in followers(scene, told))])

    def actuators(self, scene: Scene) -> np.ndarray:
        """(m,) places in ``scene``'s u of the columns of ``command``; raises UserError where there is none."""
        if self.actuator_names:
            for name in self.actuator_names:
                if name not in scene.actuator_names:
                    told = did_you_mean(name, scene.actuator_names)
                    raise UserError(f"actuator {name!r} of the log is not in scene {scene.name!r}: {told}")
            return np.array([scene.actuator_names.index(name) for name in self.actuator_names], dtype=np.int64)
        if not self.command.shape[1]:
            return np.zeros(0, dtype=np.int64)
        lines = scene.core.act_line.tolist()
        found = []
        for name, coordinate in zip(self.joint_names, self.coordinates(scene).tolist(), strict=True):
            if not (count := lines.count(coordinate)):
                kind = "position --kp GAIN" if self.command_kind == "position" else "motor"
                raise UserError(
                    f"joint {name!r} has a command in the log and no actuator in scene {scene.name!r}; add one to the "
                    f"file (a URDF has none: `cmbrl convert FILE.urdf FILE.xml --actuators {kind}`)"
                )
            if count > 1:
                raise UserError(
                    f"joint {name!r} has {count} actuators in scene {scene.name!r}; name the columns of "
                    f"{COMMANDS[self.command_kind]} by actuator_names"
                )
            found.append(lines.index(coordinate))
        return np.array(found, dtype=np.int64)

    def check(self, scene: Scene) -> None:
        """Raises UserError unless this is a log of all joints and actuators of ``scene`` without faults that show.

        Joints that the file ties to one of the log, or that its closed loops place, need no column.
        """
        if not hasattr(scene, "core"):
            raise UserError(f"scene is a {type(scene).__name__}; give the Scene of the robot")
        places, driven, floating = self.coordinates(scene), self.actuators(scene), free_joint(scene)
        if self.base is not None and floating is None:
            raise UserError(
                f"the log has the pose of a base, and scene {scene.name!r} has not one free joint; leave it out"
            )
        known = {*self.joint_names, *([floating] if self.base is not None and floating else [])}
        tied = {place for place, _, _ in followers(scene, places.tolist())}
        tied.update(self.looped(scene))
        known |= {joint.name for joint in scene.joints if joint.vadr in tied} | {j.name for j in plays(scene.joints)}
        if missing := [name for name in scene.joint_names if name not in known]:
            free = missing[0] == floating
            how = "log its pose as base_position and base_quaternion" if free else "log it"
            if not free:
                missing = to_hold(scene, [j.vadr for j in scene.joints if j.name in known]) or missing
            raise UserError(
                f"joint {missing[0]!r} of scene {scene.name!r}{', a free body,' if free else ''} is not in the log, "
                f"and its motion cannot be simulated without a start; {how}, or hold it: "
                f"`cmbrl convert FILE.xml HELD.xml {holding(missing, scene.joint_names)}`"
            )
        if undriven := sorted(set(range(scene.nu)) - set(driven.tolist())):
            raise UserError(
                f"actuator {scene.actuator_names[undriven[0]]!r} of scene {scene.name!r} has no command in the log; "
                "log it, or remove it from the file"
            )
        plausible.check_positions(self, scene)

    def going_on(self, scene: Scene) -> PositionLog:
        """The same log with whole turns added to the angles, and their targets, that begin again after one."""
        position, command = self.position.copy(), self.command.copy()
        hinges, lines = turns.hinges(scene), scene.core.act_line[self.actuators(scene)].tolist()
        for k, place in enumerate(self.coordinates(scene).tolist()):
            if place not in hinges:
                continue
            position[:, k] = turns.going_on(position[:, k], self.episode, hinges[place])
            if self.command_kind == "position" and place in lines and (position[:, k] != self.position[:, k]).any():
                target = lines.index(place)
                command[:, target] = turns.nearest(command[:, target], position[:, k])
        return replace(self, position=position, command=command)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes ``NAME.npz``, completely or not at all; raises UserError for another suffix."""
        position_file.check_target(path)
        content = io.BytesIO()
        np.savez_compressed(content, **position_file.arrays_of(self))  # type: ignore[arg-type]
        write_bytes(path, content.getvalue())

    @staticmethod
    def load(path: str | os.PathLike[str]) -> PositionLog:
        """Reads an npz of the keys in ``position_file``; raises UserError that names the file if it is missing, of
        another kind or damaged. Where both are there, ``commanded_position`` is the command, since ``torque`` follows
        from it.
        """
        found = read_arrays(regular_file(path, "import a log with `cmbrl import`, or check the path"))
        try:
            return PositionLog(**position_file.fields_of(found))
        except UserError as error:
            raise UserError(f"{path}: {error}") from None


def free_joint(scene: Scene) -> str | None:
    """The name of the only free joint of ``scene``; None if there is none or several."""
    balls = [joint.source for joint in scene.joints if joint.kind == JointKind.BALL]
    free = [source for source in balls if sum(joint.source == source for joint in scene.joints) > 1]
    return scene.joint_names[free[0]] if len(free) == 1 else None
