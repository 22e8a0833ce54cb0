"""What both kinds of log tell about the motion of a scene, in one form for all checks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.drive import law_of
from cmbrl.data.fields import Fields
from cmbrl.data.splitting import follows
from cmbrl.data.stretches import between
from cmbrl.data.ties import laws
from cmbrl.data.turns import TURN, whole, within_a_turn
from cmbrl.scene import kinematics
from cmbrl.scene.fittable.play import plays
from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene

LAG = 0.3  #: [s] a joint answers its command within this time
LAGS = 16  #: lags that are tried
MOST = 20000  #: rows whose commands and answers are compared


@dataclass(frozen=True)
class Coordinate:
    """A hinge or a slide of the log."""

    name: str
    hinge: bool
    dof: int  #: its place in v
    low: float  #: limits of the file [rad, m]; infinite where there are none
    high: float
    above: tuple[int, ...] = ()  #: places in ``Motion.coordinates`` of the joints that carry it
    spindle: bool = False  #: a hinge that the file ties to a slide, which may take many turns


@dataclass(frozen=True)
class Driver:
    """A column of commands that acts on one coordinate."""

    name: str
    coordinate: int  #: place in ``Motion.coordinates``
    position: bool  #: a target of a position servo, else a force
    scale: float  #: a target [rad, m, rad/s, m/s] is ``scale * u``; of a force, only the sign counts
    low: float  #: bounds of the file on u
    high: float
    pace: bool = False  #: a target of a velocity servo, which is a force as well
    strength: float = 1.0  #: [N m, N per unit of u] by the file, of a force
    push: float = np.inf  #: [m/s^2, rad/s^2 per unit of u] by the file, at qpos0, if nothing else pushes


@dataclass(frozen=True)
class Motion:
    """R pairs of neighbouring samples, ``dt`` apart, of n hinges and slides, and m commands.

    Velocities are None if the log has none. ``blocks`` are the stretches without a gap.
    """

    dt: float
    coordinates: tuple[Coordinate, ...]
    now: np.ndarray  #: (R, n)
    after: np.ndarray  #: (R, n)
    v_now: np.ndarray | None  #: (R, n)
    v_after: np.ndarray | None
    drivers: tuple[Driver, ...]
    u: np.ndarray  #: (R, m)
    blocks: tuple[slice, ...]
    kind: str  #: "q" or "joint_position": how the log calls positions
    command: str  #: how it calls commands
    stands: bool = False  #: on what it touches: a base that nothing holds
    step: float = 0.0  #: [s] of the file

    @cached_property
    def change(self) -> np.ndarray:
        """(R, n) change of position from one sample to the next, without whole turns of hinges that stay within one."""
        step = self.after - self.now
        for k in np.flatnonzero(self.wraps):
            step[:, k] -= TURN * whole(step[:, k], np.isfinite(self.coordinates[k].low))
        return step

    @cached_property
    def wraps(self) -> np.ndarray:
        """Which coordinates (n,) are hinges whose angle begins again after a whole turn."""
        columns = zip(self.coordinates, self.now.T, self.after.T, strict=True)
        return np.array([one.hinge and _wraps(now, after, np.isfinite(one.low)) for one, now, after in columns], bool)

    def later(self, by: int) -> Motion:
        """The same with the commands of ``by`` rows before."""
        return self if not by else replace(self, u=np.concatenate([np.repeat(self.u[:1], by, axis=0), self.u[:-by]]))

    def position_of(self, k: int) -> str:
        """The position column of coordinate k, for messages."""
        return f"{self.kind} of joint {self.coordinates[k].name!r}"

    def velocity_of(self, k: int) -> str:
        """The velocity column of coordinate k, for messages."""
        return f"v of joint {self.coordinates[k].name!r}"

    def command_of(self, m: int) -> str:
        """The command column m, for messages."""
        return f"{self.command} of {self.drivers[m].name!r}"

    def answers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How positions, or velocities, follow targets: best and worst correlation (m, m) of all lags, slopes.

        Entry (a, b) is target a against the coordinate of target b. The slope is that of positions over targets at the
        best lag. NaN where either rests, or the command is a force. Means of blocks do not count.
        """
        return self.following([m for m, driver in enumerate(self.drivers) if driver.position or driver.pace])

    def following(self, servos: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same of ``servos`` alone, as if they were targets, whatever they are."""
        size = len(self.drivers)
        best, worst, slope = np.full((3, size, size), np.nan)
        targets = self.u[:, servos] * [self.drivers[m].scale for m in servos]
        paced, own = [self.drivers[m].pace for m in servos], [self.drivers[m].coordinate for m in servos]
        places = np.where(paced, self.change[:, own] / self.dt, self.now[:, own])
        lags = np.unique(np.linspace(0, LAG / self.dt, LAGS).round().astype(int))
        blocks = tuple(slice(one.start, min(one.stop, MOST)) for one in self.blocks if one.start < MOST)
        found = [_correlation(targets, places, blocks, lag) for lag in lags]
        with np.errstate(invalid="ignore", divide="ignore"):
            all_r = np.array([c / np.sqrt(np.outer(xx, yy)) for c, xx, yy in found])
            slopes = np.array([c / xx[:, None] for c, xx, _ in found])
        if servos and len(found):
            at = np.ix_(servos, servos)
            all_r = np.where(np.isfinite(all_r), all_r, np.nan)
            filled = np.nan_to_num(all_r, nan=-2.0)
            which = filled.argmax(axis=0)[None]
            best[at] = np.take_along_axis(all_r, which, axis=0)[0]
            worst[at] = -np.nan_to_num(-all_r, nan=-2.0).max(axis=0)
            slope[at] = np.take_along_axis(slopes, np.abs(np.nan_to_num(all_r)).argmax(axis=0)[None], axis=0)[0]
        return best, worst, slope


def _wraps(now: np.ndarray, after: np.ndarray, limited: bool) -> bool:
    return len(now) > 0 and within_a_turn(now, after) and bool(whole(after - now, limited).any())


def white_noise(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Deviations (n,) of the white noise that third differences of ``parts`` (R, n) show; 0 of too few rows."""
    third = np.concatenate([np.diff(part, n=3, axis=0) for part in parts])
    if not len(third):
        return np.zeros(third.shape[1:])
    return np.asarray(1.4826 * np.median(np.abs(third), axis=0) / np.sqrt(20.0))


def _correlation(
    x: np.ndarray, y: np.ndarray, blocks: tuple[slice, ...], lag: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sums of products (m, m) of x some rows before y, and of squares (m,), about the means of each block."""
    cross, xx, yy = np.zeros((x.shape[1], y.shape[1])), np.zeros(x.shape[1]), np.zeros(y.shape[1])
    for block in blocks:
        if block.stop - block.start < 2 * lag + 3:
            continue
        a, b = x[block.start : block.stop - lag], y[block.start + lag : block.stop]
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        a, b = np.where(np.abs(a) < 1e-9, 0.0, a), np.where(np.abs(b) < 1e-9, 0.0, b)  # a constant's rounding
        cross, xx, yy = cross + a.T @ b, xx + (a * a).sum(axis=0), yy + (b * b).sum(axis=0)
    return cross, xx, yy


def of_transitions(log: Fields, scene: Scene) -> Motion:
    """The motion in the arrays of transitions."""
    free = {joint.vadr for joint in plays(scene.joints)}  # which no sensor tells
    joints = [joint for joint in scene.joints if joint.kind != JointKind.BALL and joint.vadr not in free]
    coordinates = _coordinates(scene, [joint.vadr for joint in joints])
    q = [joint.qadr for joint in joints]
    v = [joint.vadr for joint in joints]
    columns = list(range(scene.nu))
    drivers, used = _drivers(scene, coordinates, columns, None)
    return Motion(
        dt=log["dt"], coordinates=coordinates, now=log["q"][:, q], after=log["q_next"][:, q],
        v_now=log["v"][:, v], v_after=log["v_next"][:, v], drivers=drivers, u=log["u"][:, used],
        blocks=between(~follows(log)), kind="q", command="u", stands=_stands(scene), step=scene.timestep,
    )  # fmt: skip


def of_positions(log: PositionLog, scene: Scene) -> Motion:
    """The motion in a position log."""
    coordinates = _coordinates(scene, log.coordinates(scene).tolist())
    told = None if log.command_kind == "control" else log.command_kind == "position"
    drivers, used = _drivers(scene, coordinates, log.actuators(scene).tolist(), told)
    rows = np.flatnonzero(log.episode[1:] == log.episode[:-1])
    return Motion(
        dt=log.dt, coordinates=coordinates, now=log.position[rows], after=log.position[rows + 1], v_now=None,
        v_after=None, drivers=drivers, u=log.command[rows][:, used], blocks=between(np.diff(rows) != 1),
        kind="joint_position", command="commanded_position" if log.command_kind == "position" else log.command_kind,
        stands=_stands(scene),
    )  # fmt: skip


def _stands(scene: Scene) -> bool:
    sources = [joint.source for joint in scene.joints]
    free = [joint for joint in scene.joints if joint.kind == JointKind.BALL and sources.count(joint.source) > 1]
    return bool(free) and scene.core.ncontact > 0


def _coordinates(scene: Scene, dofs: list[int]) -> tuple[Coordinate, ...]:
    core, known = scene.core, {joint.vadr: joint for joint in scene.joints}
    limits = {int(line): (low, high) for line, low, high in zip(core.lim_line, core.lim_lo, core.lim_hi, strict=True)}
    place = {dof: k for k, dof in enumerate(dofs)}
    spindles = {one for one, leader, _ in laws(scene) if known[one].kind != known[leader].kind == JointKind.SLIDE}

    def above(dof: int) -> tuple[int, ...]:
        carriers = kinematics.joints_above(core, int(core.body_parent[known[dof].body]))
        return tuple(place[j] for j in (int(core.jnt_vadr[c]) for c in carriers) if j in place)

    return tuple(
        Coordinate(
            scene.coordinate_names[dof], known[dof].kind == JointKind.HINGE, dof,
            *limits.get(dof, (-np.inf, np.inf)), above(dof), dof in spindles,
        )
        for dof in dofs
    )  # fmt: skip


def _drivers(
    scene: Scene, coordinates: tuple[Coordinate, ...], columns: list[int], position: bool | None
) -> tuple[tuple[Driver, ...], list[int]]:
    """The actuators of single coordinates, their places in u. ``position``: whether u is targets (None: see file)."""
    P, layout, core = scene.core.P, scene.layout, scene.core
    place = {coordinate.dof: k for k, coordinate in enumerate(coordinates)}
    drivers, used = [], []
    for column, a in enumerate(columns):
        line, gear, gain, bias = (
            int(core.act_line[a]),
            *(P[layout.actuator(a, field)] for field in ("gear", "gain", "bias1")),
        )
        if line not in place or gear == 0 or gain == 0:
            continue
        servo = bias < 0 if position is None else position
        low, high = core.act_ctrl[a] if position is None else (-np.inf, np.inf)
        scale = 1.0 if position is not None else -gain / (bias * gear) if servo else np.sign(gear * gain)
        paced = position is None and law_of(scene, a)[0] == "velocity"
        scale = 1.0 / gear if paced else scale
        name = scene.actuator_names[a]
        push, strength = float(abs(gear * gain) * core.line_invweight[line]), 1.0 if position is False else gear * gain
        bounds = float(low), float(high)
        drivers.append(Driver(name, place[line], servo, float(scale), *bounds, paced, float(strength), push))
        used.append(column)
    return tuple(drivers), used
