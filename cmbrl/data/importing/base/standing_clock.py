"""The clock of a capture against that of the robot, by what stands on the floor.

A foot that stands does not move over the floor. With the base of one moment and the joints of another it seems to: by
as much as the foot moves in the axes of the base meanwhile. So of offsets near the one that joints and base have told
(``base_clock``), that one wins at which what stands moves and sinks least, with the markers of the capture in their
best place at each (``markers``). Parts of the motion tell offsets of their own, whose spread is the error. A gait tells
it within a millisecond, where joints and base move alike from step to step and tell it within ten; a robot that sways
on feet that hardly move in its axes does not tell it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cmbrl.data.importing.base import feet
from cmbrl.data.importing.base.clock import SAME, Offset, lowest
from cmbrl.data.importing.base.markers import PARTS, Pairs, rows_of_pairs
from cmbrl.data.importing.bodies import PLACE, QUATERNION, Floating, joints_of
from cmbrl.data.importing.build import configurations
from cmbrl.data.importing.grid import Key, Series
from cmbrl.data.importing.tied import followers
from cmbrl.data.smoothing import smooth, smooth_rotations
from cmbrl.scene import Scene

_LEAST = 4.0  # [s] of motion
_PAIRS, _ITERATIONS = 240, 5  # of rows; to the best place of the markers at a nearby offset
_WIDE, _STEPS = 4.0, 7  # times the error of the offset to either side, that are tried; so many
_PASSES, _CLOSER = 2, 0.3  # of which the second is so much narrower
_READ = 0.15  # of the capture's time step: what smoothing and reading in between leave open

Poses = Callable[[np.ndarray], np.ndarray]  # (T, 7) at times (T,) [s] of the capture


def refined(
    robot: dict[Key, Series], time: np.ndarray, poses: np.ndarray, base: Floating, scene: Scene, told: Offset
) -> Offset | None:
    """The offset near ``told`` at which feet stand best, if they tell it more closely.

    ``robot``: what it logged, with the position of every joint; ``poses`` (T, 7) at ``time`` (T,) of the capture.
    """
    series = next(one for key, one in robot.items() if key[1] == "position")
    at = series.time[(series.time > time[0] - told.seconds) & (series.time < time[-1] - told.seconds)]
    if not feet.stands(scene, base) or len(at) < 2 or np.ptp(at) < _LEAST:
        return None
    rows, lasting = rows_of_pairs(len(at), float(np.median(np.diff(at))), _PAIRS)
    moments, read = at[rows.ravel()], _between(time, poses)
    q = _postures(robot, moments, read(moments + told.seconds), base, scene)
    if feet.steps(scene, base, q):
        return None
    q[:, base.qadr : base.qadr + 7] = 0.0
    q[:, base.position["qw"]] = 1.0
    touching, order = feet.Touching.of(scene, q), np.arange(rows.size).reshape(rows.shape)
    begun = Pairs.of(read(moments + told.seconds), touching, order, lasting)
    best, seconds = begun.best(), told.seconds
    half = _WIDE * max(told.error, float(np.median(np.diff(time))))
    for _ in range(_PASSES):
        shifts = seconds + np.linspace(-half, half, _STEPS)
        tried = [replace(begun, poses=read(moments + shift).reshape(begun.poses.shape)) for shift in shifts]
        seconds = lowest(shifts, _misfits(tried, best))
        if not shifts[1] < seconds < shifts[-2]:
            return None
        half *= _CLOSER
    parts = np.array_split(np.arange(len(rows)), PARTS)
    own = [lowest(shifts, _misfits([pairs.some(part) for pairs in tried], best)) for part in parts]
    error = float(np.hypot(np.std(own, ddof=1) / np.sqrt(PARTS), _READ * np.median(np.diff(time))))
    sure = error <= SAME * float(np.median(np.diff(time)))
    return Offset(seconds, error, sure) if error < told.error else None


def _misfits(tried: list[Pairs], x: np.ndarray) -> np.ndarray:
    """How far what stands is from standing, squared, with the markers where they are best, near ``x`` (7,)."""
    return np.array([pairs.misfit(pairs.fitted(x, _ITERATIONS, 0)) ** 2 for pairs in tried])


def _between(time: np.ndarray, poses: np.ndarray) -> Poses:
    """The smoothed ``poses`` (T, 7), between samples linearly; outside, the first or last."""
    dt, one = float(np.median(np.diff(time))), np.zeros(len(time), dtype=np.int64)
    turn = smooth_rotations(poses[:, 3:], dt, one).value
    flips = np.cumprod(np.where((turn[1:] * turn[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    turn[1:] *= flips[:, None]
    columns = np.hstack([smooth(poses[:, :3], dt, one).value, turn])

    def at(moments: np.ndarray) -> np.ndarray:
        found = np.column_stack([np.interp(moments, time, column) for column in columns.T])
        found[:, 3:] /= np.linalg.norm(found[:, 3:], axis=1, keepdims=True)
        return found

    return at


def _postures(
    robot: dict[Key, Series], moments: np.ndarray, poses: np.ndarray, base: Floating, scene: Scene
) -> np.ndarray:
    """q (T, nq) at ``moments`` (T,) of the robot's clock, with the base at ``poses`` (T, 7)."""
    whole, singles = robot | followers(robot, scene)[0], {joint.name for joint in joints_of(scene)[0]}
    episode = {
        key: np.interp(moments, one.time, one.values[:, 0])[:, None]
        for key, one in whole.items()
        if key[1] == "position" and key[0] in singles
    }
    episode |= {(base.name, x): poses[:, k : k + 1] for k, x in enumerate(PLACE)}
    return configurations({**episode, (base.name, QUATERNION): poses[:, 3:]}, scene)
