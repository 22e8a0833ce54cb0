"""Smooth periodic commands within the limits of the actuators: a sum of tones for each, ramped in from rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.fittable.play import plays

TONES = 5
RAMP = 1.0  # [s] from the start to the full command
_FREE = 0.5  # [rad, m] either way, of a servo whose joint has no limits


@dataclass(frozen=True)
class Ranges:
    """What commands may be: ``low``, ``high``, and the first of them, at ``rest`` (nu,); ``servo`` (nu,): of positions.

    ``start`` (nq,): where servos hold the robot by the first commands.
    """

    low: np.ndarray
    high: np.ndarray
    rest: np.ndarray
    servo: np.ndarray
    start: np.ndarray

    @classmethod
    def of(cls, scene: Scene, q: np.ndarray, margin: float) -> Ranges:
        """Of ``scene`` at rest in ``q`` (nq,); ``margin`` is the share of each range that is kept clear at both ends.

        What lies beyond its range there, as in many files the initial pose does, starts at the nearest place within.
        Raises UserError for an actuator without limits.
        """
        core, layout, start = scene.core, scene.layout, q.copy()
        hinges = {j.vadr: j.qadr for j in scene.joints}
        limits = joint_limits(scene)
        low, high, rest, servo = (np.zeros(scene.nu) for _ in range(4))
        for k, line in enumerate(core.act_line.tolist()):
            gear, gain, feedback = core.P[[layout.actuator(k, f) for f in ("gear", "gain", "bias1")]]
            bounds = np.array(core.act_ctrl[k], dtype=float)
            servo[k] = gain > 0 and feedback == -gain and line in hinges
            if servo[k]:
                rest[k] = gear * q[hinges[line]]
                near = rest[k] + np.array([-_FREE, _FREE])
                joint = np.sort(gear * limits[line])
                bounds = np.clip(bounds, *np.where(np.isfinite(joint), joint, near))
            elif gain and not np.isfinite(bounds).all():
                bounds = np.sort(np.array(core.act_force[k]) / gain)
            name = scene.actuator_names[k]
            if not np.isfinite(bounds).all():
                raise UserError(f"actuator {name!r} of {scene.name!r} has no limits: give it a ctrlrange in the file")
            clear = margin * (bounds[1] - bounds[0])
            low[k], high[k] = bounds[0] + clear, bounds[1] - clear
            rest[k] = np.clip(rest[k], low[k], high[k])
            if servo[k]:
                start[hinges[line]] = rest[k] / gear
        return cls(low, high, rest, servo.astype(bool), start)


def joint_limits(scene: Scene) -> np.ndarray:
    """Limits (nv, 2) of the coordinates; infinite where there are none, and of plays, which lie at their ends."""
    limits = np.tile([-np.inf, np.inf], (scene.nv, 1))
    core, hidden = scene.core, {joint.vadr for joint in plays(scene.joints)}
    for line, ball, low, high in zip(core.lim_line, core.lim_ball, core.lim_lo, core.lim_hi, strict=True):
        if line < scene.nv and ball < 0 and line not in hidden:
            limits[line] = low, high
    return limits


@dataclass(frozen=True)
class Tones:
    """Commands of n candidates: ``centre``, ``size`` (n, nu) as shares, ``frequency`` [Hz], ``weight``, ``phase``
    (n, nu, TONES)."""

    centre: np.ndarray
    size: np.ndarray
    frequency: np.ndarray
    weight: np.ndarray
    phase: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, count: int, nu: int, seconds: float, fastest: float) -> Tones:
        """Candidates between two periods of the whole and ``fastest`` [Hz]."""
        shape = (count, nu, TONES)
        slowest = min(2.0 / seconds, fastest)
        return cls(
            rng.uniform(-1.0, 1.0, shape[:2]) * rng.uniform(0.0, 1.0, (count, 1)),
            rng.uniform(0.2, 1.0, shape[:2]),
            slowest * (fastest / slowest) ** rng.random(shape),
            rng.standard_normal(shape),
            rng.uniform(0.0, 2.0 * np.pi, shape),
        )

    def mixed(self, other: Tones, rng: np.random.Generator, share: float) -> Tones:
        """These with a ``share`` of their actuators taken from ``other``."""
        taken = rng.random(self.centre.shape) < share
        parts = [
            np.where(taken.reshape(taken.shape + (1,) * (a.ndim - 2)), b, a)
            for a, b in zip(vars(self).values(), vars(other).values(), strict=True)
        ]
        return Tones(*parts)

    def pick(self, rows: np.ndarray) -> Tones:
        """Some of the candidates."""
        return Tones(*(a[rows] for a in vars(self).values()))

    def commands(self, ranges: Ranges, time: np.ndarray) -> np.ndarray:
        """Commands (n, T, nu) at ``time`` (T,)."""
        wave = np.zeros((*self.centre.shape, len(time)))
        for k in range(TONES):
            angle = 2.0 * np.pi * self.frequency[..., k, None] * time + self.phase[..., k, None]
            wave += self.weight[..., k, None] * np.sin(angle)
        wave /= np.abs(wave).max(axis=2, keepdims=True)
        share = self.centre[..., None] + (1.0 - np.abs(self.centre))[..., None] * self.size[..., None] * wave
        middle, half = 0.5 * (ranges.low + ranges.high), 0.5 * (ranges.high - ranges.low)
        full = middle + half * np.swapaxes(share, 1, 2)
        ramp = np.clip(time / RAMP, 0.0, 1.0)
        ramp = (ramp**2 * (3.0 - 2.0 * ramp))[:, None]
        return ranges.rest + ramp * (full - ranges.rest)
