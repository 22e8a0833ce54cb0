"""A reference motion: configurations and velocities of a robot at equal steps of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.errors import UserError
from cmbrl.imitation import plausible
from cmbrl.scene import Scene
from cmbrl.scene.records import Array

SHORTEST, LONGEST = 0.5, 3600.0  # s
FASTEST = 1e5  # frames/s
FARTHEST = 1e5  # m, rad


@dataclass(frozen=True)
class Motion:
    """F frames, ``dt`` [s] apart: q (F, nq), v (F, nv), in the layout of the scene."""

    q: Array
    v: Array
    dt: float

    @classmethod
    def of_frames(cls, scene: Scene, q: Array, rate: float, dt: float, name: str) -> Motion:
        """The motion through the configurations q (N, nq) at ``rate`` frames a second, resampled to ``dt`` [s].

        Between frames coordinates are linear, and rotations turn at a constant speed (slerp). Velocities are central
        differences; a body's angular velocity is in its own axes.

        Raises UserError, led by ``name``, for frames that are not finite, too few, or no poses of the robot
        (:mod:`cmbrl.imitation.plausible`).
        """
        check_finite(q, name)
        if not 0 < rate <= FASTEST:
            raise UserError(f"{name}: rate is {rate:g}; give frames per second")
        duration = (len(q) - 1) / rate
        if not SHORTEST <= duration <= LONGEST:
            raise UserError(f"{name}: {duration:.3g} s of motion; give {SHORTEST:g} to {LONGEST:g} s")
        plausible.check(scene, q, name)
        times = np.arange(int(duration / dt + 1e-9) + 1) * dt
        place = np.minimum(times * rate, len(q) - 1 - 1e-9)
        frame = place.astype(int)
        ahead = scene.difference(q[frame], q[frame + 1])
        sampled = scene.integrate(q[frame], (place - frame)[:, None] * ahead)
        return cls(sampled, velocities(scene, sampled, dt), dt)

    @property
    def duration(self) -> float:
        """From the first frame to the last [s]."""
        return (len(self.q) - 1) * self.dt


def check_finite(q: Array, name: str) -> None:
    """Raises UserError, led by ``name``, for the first number of q (N, nq) that is not finite, or beyond any robot."""
    wrong = np.argwhere(~(np.abs(q) <= FARTHEST))
    if len(wrong):
        row, column = wrong[0]
        told = f"row {row + 1}, column {column + 1} is {q[row, column]:g}"
        raise UserError(f"{name}: {told}; give finite numbers in m and rad, or drop that frame")


def velocities(scene: Scene, q: Array, dt: float) -> Array:
    """Velocities (F, nv) at configurations q (F, nq), ``dt`` [s] apart: central differences, one-sided at the ends."""
    step = scene.difference(q[:-1], q[1:]) / dt
    back = -scene.difference(q[1:], q[:-1]) / dt  # the same, in the axes of the later configuration
    return np.concatenate([step[:1], (step[1:] + back[:-1]) / 2, back[-1:]])
