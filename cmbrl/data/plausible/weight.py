"""Torques that do not hold the weight of the links: of a driver that compensates gravity, and tells what comes on top.

Joint torques, less friction, are what the links weigh and what it takes to accelerate them. By the file, whose masses
may all be wrong by one factor, either sum is compared with the torques: where what accelerates explains them without
any weight, and with the weight nothing does, the driver has held the links by torques that the log does not tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Motion
from cmbrl.scene import kinematics

if TYPE_CHECKING:
    from cmbrl.scene import Scene

_APART, _MOST, _LEAST = 0.02, 2000, 100  # [s] between the samples that tell accelerations; most and least of them
_LOADED = 0.3  # of the largest usual weight: where joints carry less, what accelerates them hides it
_FACTORS = np.geomspace(0.4, 2.5, 15)  # by which the masses of the file may be wrong
_UNITS = {
    1e3: "it is multiplied by 1000: check its unit",
    1e-3: "it is divided by 1000: check its unit",
    -1.0: "it is negated: check its sign, or is the robot mounted upside down?",
}
_MOVES = 0.02  # of the largest speed
_UNEXPLAINED, _BETTER = 0.5, 0.5  # of the weight, with it; times that, without it


def untold(motion: Motion, scene: Scene) -> Iterator[Finding]:
    """A warning for the torques of an arm that hold none of its weight.

    Of arms alone, all of whose joints were logged and are driven by torques, where no spring, floor or compensation of
    the file holds them.
    """
    size, rows = max(1, round(_APART / motion.dt)), _rows(motion)
    if not _arm(motion, scene) or len(rows) < _LEAST:
        return
    q = np.array([_poses(motion, motion.now[rows + other], scene) for other in (-size, 0, size)])
    apart = size * motion.dt
    speed = scene.difference(q[0], q[2]) / (2.0 * apart)
    x = kinematics.centres(scene.core, q)
    weight = kinematics.holding_forces(scene.core, q[1])
    moving = kinematics.holding_forces(scene.core, q[1], (x[2] - 2.0 * x[1] + x[0]) / apart**2)
    rotor = np.array([scene.core.P[scene.layout.dof(d)] for d in range(scene.nv)])
    moving += rotor * (scene.difference(q[1], q[2]) - scene.difference(q[0], q[1])) / apart**2
    torque = _torques(motion, scene, rows, size)
    usual = np.sqrt((weight**2).mean(axis=0))
    if not usual.any():
        return
    loaded = np.flatnonzero(usual > _LOADED * usual.max())
    weighed = (moving + weight)[:, loaded] / usual[loaded]
    with_it, without = (
        _unexplained(forces, torque[:, loaded] / usual[loaded], speed[:, loaded])
        for forces in (weighed, moving[:, loaded] / usual[loaded])
    )
    if not (with_it > _UNEXPLAINED and without < _BETTER * with_it):
        return
    other = {
        told: _unexplained(weighed, factor * torque[:, loaded] / usual[loaded], speed[:, loaded])
        for factor, told in _UNITS.items()
    }
    best = min(other, key=lambda told: other[told])
    if other[best] < _BETTER * with_it:
        yield Finding(f"{motion.command} holds what the links weigh by the file if {best}", sure=False)
    else:
        yield Finding(
            f"{motion.command} holds none of what the links weigh by the file: a driver that compensates gravity tells "
            "torques without it. Import with --gravity-compensated to add the weight by the file, or check the file's "
            "gravity and how the robot is mounted",
            sure=False,
        )


def held(motion: Motion, scene: Scene, rows: slice = slice(None)) -> np.ndarray | None:
    """What the links weigh by the file at ``rows``: (R, nv); None where the log does not tell all of a pose."""
    if len(motion.coordinates) != scene.nv:
        return None
    return np.asarray(kinematics.holding_forces(scene.core, _poses(motion, motion.now[rows], scene)))


def _poses(motion: Motion, places: np.ndarray, scene: Scene) -> np.ndarray:
    """Configurations (R, nq) of all joints at ``places`` (R, n)."""
    address = {joint.vadr: joint.qadr for joint in scene.joints}
    q = np.zeros((len(places), scene.nq))
    q[:, [address[coordinate.dof] for coordinate in motion.coordinates]] = places
    return q


def _arm(motion: Motion, scene: Scene) -> bool:
    core, driven = scene.core, {d.coordinate for d in motion.drivers if not d.position}
    springs = any(p.group.endswith("stiffness") for p in scene.parameters)
    return len(motion.coordinates) == scene.nv == len(driven) == len(motion.drivers) and not core.nlift and not springs


def _rows(motion: Motion) -> np.ndarray:
    """Rows (R,) in the middle of their blocks, at most ``_MOST``."""
    size = max(1, round(_APART / motion.dt))
    parts = [np.arange(b.start + size, min(b.stop, len(motion.now)) - size) for b in motion.blocks]
    rows = np.concatenate([*parts, np.empty(0, dtype=np.int64)])
    return rows[:: max(1, -(-len(rows) // _MOST))]


def _torques(motion: Motion, scene: Scene, rows: np.ndarray, size: int) -> np.ndarray:
    """Means (R, nv) of the joints' torques from ``size`` rows before to as many after."""
    found = np.zeros((len(rows), scene.nv))
    sums = np.vstack([np.zeros((1, motion.u.shape[1])), np.cumsum(motion.u, axis=0)])
    mean = (sums[rows + size] - sums[rows - size]) / (2 * size)
    for m, driver in enumerate(motion.drivers):
        found[:, motion.coordinates[driver.coordinate].dof] += driver.strength * mean[:, m]
    return found


def _unexplained(forces: np.ndarray, torque: np.ndarray, speed: np.ndarray) -> float:
    """RMS of what torques, by any factor, and friction leave of ``forces``, all (R, n)."""
    size = np.abs(speed).max(axis=0)
    left = []
    for factor in _FACTORS:
        off = forces - factor * torque
        for j in range(off.shape[1]):
            rubs = np.stack([speed[:, j], np.sign(speed[:, j]) * (np.abs(speed[:, j]) > _MOVES * size[j])], axis=1)
            off[:, j] -= rubs @ np.linalg.lstsq(rubs, off[:, j], rcond=None)[0]
        left.append(np.sqrt((off**2).mean()))
    return float(min(left))
