"""Rolling: spheres that slide until they roll, on the flat and on inclines, SimBenchmark's plate. F8, F9, F10."""

from __future__ import annotations

from math import atan, cos, sin, sqrt

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant, proportional
from cmbrl.bench.studies.stability.worlds import GROUND, body, box, sphere, tilted, world

RADIUS = 0.1  # [m]


def _ball(joints: str = "xzr") -> str:
    return body("ball", (0, 0, RADIUS), joints, sphere("ball", RADIUS))


def rolling_path(t: np.ndarray, mu: float, v0: float) -> np.ndarray:
    """Way of a sphere set sliding without spin: v0 t - mu g t^2/2 until t = 2 v0/(7 mu g), then at 5/7 v0."""
    until = 2 * v0 / (7 * mu * G)
    slid = np.minimum(t, until)
    return v0 * slid - 0.5 * mu * G * slid**2 + 5 / 7 * v0 * (t - slid)


def _set_sliding() -> Case:
    mu, v0 = 0.2, 1.0

    def error(run: Run) -> float:
        way = np.abs(run.q[:, 0] - rolling_path(run.t, mu, v0)).max()
        return float(max(way / (12 * v0**2 / (49 * mu * G)), abs(run.v[-1, 2] * RADIUS - 5 / 7 * v0) / v0))

    return Case("v0 = 1 m/s", world(GROUND, _ball(), mu=mu), 0.4, error, v=(v0, 0, 0))


def _on_incline(tangent: float, mu: float, spin: float = 0.0) -> Case:
    """a = 5/7 g sin and alpha = a/r while tan <= 7 mu/2, else a = g (sin - mu cos), alpha = 5 mu g cos/(2 r)."""
    angle, T = atan(tangent), 0.5
    rolls = tangent <= 3.5 * mu
    a = 5 / 7 * G * sin(angle) if rolls else G * (sin(angle) - mu * cos(angle))
    alpha = a / RADIUS if rolls else 2.5 * mu * G * cos(angle) / RADIUS

    def error(run: Run) -> float:
        t = run.t[-1]
        along, turned = abs(run.v[-1, 0] - a * t), abs(run.v[-1, 2] - spin - alpha * t) * RADIUS
        return float(max(along, turned) / (G * sin(angle) * t))

    mjcf = world(GROUND, _ball(), mu=mu, gravity=tilted(angle))
    return Case(f"tan {tangent:g}, mu {mu:g}", mjcf, T, error, v=(0, 0, spin))


def plate_and_balls(M: float, m: float, n: int, mu: float, F: float) -> tuple[float, float]:
    """Accelerations [m/s^2] of a plate that F pulls over the ground, and of n balls that roll on it: with
    f1 = mu (M + n m) g and f2 = (F - f1)/(3.5 M/m + n), (F - f1 - n f2)/M and f2/m (Kang and Hwangbo, SimBenchmark)."""
    f1 = mu * (M + n * m) * G
    f2 = (F - f1) / (3.5 * M / m + n)
    return (F - f1 - n * f2) / M, f2 / m


def _plate(direction: tuple[float, float], balls: int) -> Case:
    """The friction of the ground wins by priority over the balls' larger one."""
    M, m, n, mu1, mu2, F, T = 10.0, 1.0, balls**2, 0.4, 0.8, 150.0, 0.2
    a_plate, a_ball = plate_and_balls(M, m, n, mu1, F)
    ground = f'<geom name="ground" type="plane" size="50 50 1" friction="{mu1} 0 0" priority="1"/>'
    plate = body("plate", (0, 0, 0.05), "xyz", box("plate", (2.5, 2.5, 0.05), M))
    spots = [(i - (balls - 1) / 2, j - (balls - 1) / 2) for i in range(balls) for j in range(balls)]
    on_top = [
        body(f"ball{k}", (x, y, 0.1 + RADIUS), "f", sphere(f"ball{k}", RADIUS, m)) for k, (x, y) in enumerate(spots)
    ]
    way = np.array(direction) / sqrt(direction[0] ** 2 + direction[1] ** 2)

    def error(run: Run) -> float:
        t, v = run.t[-1], run.v[-1]
        plate_error = np.linalg.norm(v[:2] - a_plate * t * way) / (a_plate * t)
        ball = v[3:].reshape(n, 6)[:, :2]
        return float(max(plate_error, np.linalg.norm(ball - a_ball * t * way, axis=1).max() / (a_ball * t)))

    mjcf = world(ground, plate, *on_top, mu=mu2, motors=("plate_x", "plate_y"))
    return Case(f"along ({direction[0]:g}, {direction[1]:.3g})", mjcf, T, error, control=tuple(F * way), samples=2)


SCENES = (
    BankScene("F8", "trajectory", (_set_sliding(),), proportional(10.0), 1),
    BankScene(
        "F9", "trajectory", (_on_incline(0.3, 0.4), _on_incline(1.0, 0.2), _on_incline(0.3, 0.0, 1.0)), constant(1e-4)
    ),
    BankScene("F10", "trajectory", (_plate((0, 1), 5), _plate((0.5, sqrt(0.75)), 5)), constant(1e-4)),
)  # fmt: skip
