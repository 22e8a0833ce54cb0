"""Sliding: friction that stops, holds, tips and pulls along. F4, F5, F6, F7, F11, F20 of the bank."""

from __future__ import annotations

from math import atan, cos, pi, sin, sqrt

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant, proportional, resting
from cmbrl.bench.studies.stability.worlds import GROUND, body, box, sphere, tilted, world

SIDE, V0 = 0.2, 1.0  # of the cube [m], of its start [m/s]
HALF = SIDE / 2
DAMPER = 1e6  # of the conveyor [N s/m]


def _cube(joints: str) -> str:
    return body("cube", (0, 0, HALF), joints, box("cube", (HALF, HALF, HALF)))


def stopping_distance(mu: float, v0: float = V0) -> float:
    """v0^2/(2 mu g) [m]."""
    return v0**2 / (2 * mu * G)


def stopping_path(t: np.ndarray, mu: float, v0: float = V0) -> np.ndarray:
    """Way of a block that slides until it stops: v0 t - mu g t^2/2 up to t = v0/(mu g)."""
    t = np.minimum(t, v0 / (mu * G))
    return v0 * t - 0.5 * mu * G * t**2


def _slide(mu: float) -> Case:
    def error(run: Run) -> float:
        way = np.abs(run.q[:, 0] - stopping_path(run.t, mu)).max()
        return max(way, np.abs(run.q[:, 1]).max()) / stopping_distance(mu)

    return Case("v0 = 1 m/s", world(GROUND, _cube("xzr"), mu=mu), 0.4, error, v=(V0, 0, 0))


def _incline(tangent: float, mu: float) -> Case:
    """Velocity after one second against a = g (sin - mu cos) or rest, as a share of g sin t."""
    angle = atan(tangent)
    a = max(0.0, G * (sin(angle) - mu * cos(angle)))
    mjcf = world(GROUND, _cube("xzr"), mu=mu, gravity=tilted(angle))
    return Case(
        f"tan = mu {tangent / mu:.4g}", mjcf, 1.0,
        lambda run: np.hypot(run.v[-1, 0] - a * run.t[-1], run.v[-1, 1]) / (G * sin(angle) * run.t[-1]),
    )  # fmt: skip


def tipping(angle: float, width: float, height: float, times: np.ndarray) -> np.ndarray:
    """Angular velocity (n,) of a box that tips about its lower edge, from rest on the incline: the pendulum
    I w' = m g |r| sin(position), I = m (w^2 + H^2)/3 about the edge, by Runge-Kutta steps of at most 1e-4 s."""
    rate = 1.5 * G / sqrt(width**2 + height**2)
    start = angle - atan(width / height)  # of the edge-to-centre line, from the vertical

    def slope(y: np.ndarray) -> np.ndarray:
        return np.array([y[1], rate * sin(y[0])])

    y, now, out = np.array([start, 0.0]), 0.0, []
    for t in times:
        pieces = max(1, int(np.ceil((t - now) / 1e-4)))
        d = (t - now) / pieces
        for _ in range(pieces):
            k1 = slope(y)
            k2 = slope(y + d / 2 * k1)
            k3 = slope(y + d / 2 * k2)
            y = y + d / 6 * (k1 + 2 * k2 + 2 * k3 + slope(y + d * k3))
        now = t
        out.append(y[1])
    return np.array(out)


def _box_on_incline(tangent: float, mu: float, ratio: float) -> Case:
    """What comes first, sliding at tan > mu or tipping at tan > w/H; error in velocities as shares of free fall."""
    width, angle, T = SIDE, atan(tangent), 0.2
    height = width / ratio
    tips, slides = tangent > ratio and ratio < mu, tangent > mu and mu < ratio
    a = G * (sin(angle) - mu * cos(angle)) if slides else 0.0
    spin = tipping(angle, width, height, np.array([T]))[0] if tips else 0.0
    radius = sqrt(width**2 + height**2) / 2
    lean = atan(width / height) if tips else 0.0

    def error(run: Run) -> float:
        v = run.v[-1]
        along = v[0] - a * T
        if tips:  # the centre moves about the edge, by angle and spin
            along = v[0] - radius * spin * cos(run.q[-1, 2] - lean)
        return float(max(abs(along), abs(v[2] - spin) * radius) / (G * sin(angle) * T))

    block = body("block", (0, 0, height / 2), "xzr", box("block", (width / 2, HALF, height / 2)))
    verb = "tips" if tips else "slides" if slides else "rests"
    return Case(f"{verb}, tan = {tangent:g}", world(GROUND, block, mu=mu, gravity=tilted(angle)), T, error)


def _diagonal(mu: float) -> Case:
    def error(run: Run) -> float:
        way = np.linalg.norm(run.q[:, :2], axis=1)
        aside = np.abs(run.q[:, 0] - run.q[:, 1]).max()
        return max(np.abs(way - stopping_path(run.t, mu)).max(), aside) / stopping_distance(mu)

    v = (V0 / sqrt(2), V0 / sqrt(2), 0, 0, 0, 0)
    return Case("(1, 1)/sqrt 2", world(GROUND, _cube("f"), mu=mu), 0.4, error, v=v)


def _conveyor() -> Case:
    """Undamped oscillation about mu m g/k with amplitude v_belt sqrt(m/k); the belt is a box on a slide that a motor
    and a damper of 1e6 N s/m hold at its speed to 3e-6 m/s."""
    m, k, mu, speed, T = 1.0, 100.0, 0.3, 0.2, 10.0
    centre, amplitude = mu * m * G / k, speed * sqrt(m / k)
    mass = body(
        "mass", (0, 0, 0.1), "z",
        f'<joint name="mass_x" type="slide" axis="1 0 0" stiffness="{k}"/>' + sphere("mass", 0.1, m),
    )  # fmt: skip
    belt = body(
        "belt", (0, 0, -0.5), "",
        f'<joint name="belt_x" type="slide" axis="1 0 0" damping="{DAMPER}"/>' + box("belt", (20, 1, 0.5)),
    )  # fmt: skip

    def error(run: Run) -> float:
        x = run.q[run.t > T - 4 * pi * sqrt(m / k), 1]  # the last two periods
        high, low = x.max(), x.min()
        return max(abs((high + low) / 2 - centre), abs((high - low) / 2 - amplitude)) / amplitude

    mjcf = world(mass, belt, mu=mu, motors=("belt_x",))
    return Case("belt 0.2 m/s", mjcf, T, error, v=(0, 0, speed), control=(DAMPER * speed,))


def _frictionless() -> Case:
    mjcf = world(GROUND, _cube("f"))
    return Case("mu = 0", mjcf, 0.2, lambda run: np.abs(run.v[:, 1] - V0).max() / V0, v=(0, V0, 0, 0, 0, 0))


def _infinite_friction() -> Case:
    """Sticks and pivots about the leading edge: w = 3 (v0 - g h)/(4 a) about x, v' = (0, a w/2, a w/2), one step."""

    def error(run: Run) -> float:
        spin = 3 * (V0 - G * run.h) / (4 * SIDE)
        truth = np.array([0, spin * HALF, spin * HALF, -spin, 0, 0])
        return float(np.abs(run.v[1] - truth).max() / spin)

    return Case("mu = 1e3", world(GROUND, _cube("f"), mu=1e3), 0.0, error, v=(0, V0, 0, 0, 0, 0))


SCENES = (
    BankScene("F4", "trajectory", (_slide(0.4),), proportional(V0 / stopping_distance(0.4)), 1),
    BankScene(
        "F5", "trajectory", tuple(_incline(0.5 * (1 + e), 0.5) for e in (-0.1, -0.01, -0.002, 0.002, 0.01, 0.1)),
        constant(1e-4),
    ),
    BankScene(
        "F6", "trajectory",
        (
            _box_on_incline(0.4, 0.3, 1.0), _box_on_incline(0.6, 0.8, 0.5), _box_on_incline(0.505, 0.8, 0.5),
            _box_on_incline(0.495, 0.8, 0.5), _box_on_incline(0.303, 0.3, 0.5), _box_on_incline(0.297, 0.3, 0.5),
        ),
        proportional(2.0, 1e-5), 1,
    ),
    BankScene("F7", "trajectory", (_diagonal(0.5),), proportional(V0 / stopping_distance(0.5)), 1),
    BankScene("F11", "trajectory", (_conveyor(),), proportional(20.0), 1),
    BankScene("F20", "one step", (_frictionless(), _infinite_friction()), resting),
)  # fmt: skip
