"""Impacts: bounces, drops, bullets, and two or three bodies in line. F12, F13, F14, F24, F27 of the bank."""

from __future__ import annotations

from math import log, pi, sqrt

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant, proportional
from cmbrl.bench.studies.stability.worlds import GROUND, body, sphere, world

RADIUS = 0.1  # of balls [m]
STIFFNESS = 1e5  # of contacts that are to bounce in MuJoCo [1/s^2], with the damping that gives the restitution


def bouncy(e: float) -> str:
    """MuJoCo has no coefficient of restitution; a spring-damper whose half period loses as much comes nearest:
    solref = (-k, -b), b = 2 zeta sqrt k, zeta = -ln e/sqrt(pi^2 + ln^2 e). Empty (its default) for e = 0."""
    if e == 0:
        return ""
    zeta = -log(e) / sqrt(pi**2 + log(e) ** 2)
    return f"{-STIFFNESS:g} {-2 * zeta * sqrt(STIFFNESS):.6g}"


def apex_time(e: float, n: int, h0: float) -> float:
    """When the ball is highest after its n-th bounce: T0 (1 + 2 e + ... + 2 e^(n-1) + e^n), T0 = sqrt(2 h0/g)."""
    return sqrt(2 * h0 / G) * (1 + 2 * sum(e**k for k in range(1, n)) + e**n) if n else 0.0


def _falling(h0: float, e: float) -> str:
    """A ball at ``h0`` above the ground."""
    return world(GROUND, body("ball", (0, 0, RADIUS + h0), "z", sphere("ball", RADIUS)), solref=bouncy(e))


def _bounce(e: float, n: int) -> Case:
    """Energy after n bounces, e^(2n) of the first; e = 0: none is left. The horizon ends at the n-th apex."""
    h0, left = 1.0, e ** (2 * n)
    T = apex_time(e, n, h0) if e else 1.0

    def error(run: Run) -> float:
        energy = 0.5 * run.v[-1, 0] ** 2 + G * (run.q[-1, 0] + h0)
        return float(abs(energy / (G * h0) - left))

    return Case(f"e = {e:g}, {n} bounces", _falling(h0, e), T, error, restitution=e)


def _zeno() -> Case:
    """Comes to rest at sqrt(2 h0/g) (1 + e)/(1 - e), after infinitely many bounces; looked at a bit later."""
    e, h0 = 0.5, 1.0
    T = 1.3 * sqrt(2 * h0 / G) * (1 + e) / (1 - e)
    return Case(
        "e = 0.5, after Zeno's time", _falling(h0, e), T,
        lambda run: max(abs(run.q[-1, 0] + h0) / h0, abs(run.v[-1, 0]) / sqrt(2 * G * h0)), restitution=e,
    )  # fmt: skip


def _drop() -> Case:
    """Never below the ground, and at rest on it."""
    h0 = 0.5

    def error(run: Run) -> float:
        height = run.q[:, 0] + h0
        return float(max(-height.min(), abs(height[-1]), abs(run.v[-1, 0]) * sqrt(2 * h0 / G)) / h0)

    return Case("from 0.5 m", _falling(h0, 0.0), 1.0, error)


def _bullet(e: float) -> Case:
    """A sphere of 1 cm at 100 m/s against a wall of 2 cm: where it is after 30 ms, as a share of its way."""
    radius, half, v0, T = 0.01, 0.01, 100.0, 0.03
    start, stop = -1.37, -half - radius
    wall = f'<geom name="wall" type="box" size="{half} 1 1"/>'

    def error(run: Run) -> float:
        t = run.t[-1]
        truth = stop - e * (v0 * t - (stop - start))
        through = max(0.0, float((run.q[:, 0] + start - stop).max()))
        return max(abs(run.q[-1, 0] + start - truth), through) / (v0 * t)

    bullet = body("bullet", (start, 0, 0), "x", sphere("bullet", radius, 0.01))
    mjcf = world(wall, bullet, gravity=(0, 0, 0), solref=bouncy(e))
    return Case(f"e = {e:g}", mjcf, T, error, v=(v0,), restitution=e)


def _in_line(masses: tuple[float, ...], places: tuple[float, ...]) -> str:
    return "".join(
        body(f"ball{k}", (x, 0, 0), "x", sphere(f"ball{k}", RADIUS, m))
        for k, (m, x) in enumerate(zip(masses, places, strict=True))
    )


def _cradle() -> Case:
    """Momentum and energy after the first ball hit two that touch. Which balls fly is not judged: the sequential law
    (0, 0, 1) and Newton's (-1/3, 2/3, 2/3) conserve both."""
    mjcf = world(_in_line((1, 1, 1), (-0.3, 0, 0.2)), gravity=(0, 0, 0), solref=bouncy(1.0))
    return Case(
        "n = 3, e = 1", mjcf, 0.25,
        lambda run: max(abs(run.v[-1].sum() - 1), abs((run.v[-1] ** 2).sum() - 1)), v=(1, 0, 0), restitution=1.0,
    )  # fmt: skip


def _two(e: float) -> Case:
    """v1' = ((m1 - e m2) v1 + (1 + e) m2 v2)/(m1 + m2), and the same with 1 and 2 exchanged (Newton)."""
    m1, m2, v1, v2 = 1.0, 1000.0, 1.0, -0.5
    truth = np.array(
        [((m1 - e * m2) * v1 + (1 + e) * m2 * v2) / (m1 + m2), ((m2 - e * m1) * v2 + (1 + e) * m1 * v1) / (m1 + m2)]
    )
    mjcf = world(_in_line((m1, m2), (-0.2, 0.15)), gravity=(0, 0, 0), solref=bouncy(e))
    return Case(
        f"e = {e:g}", mjcf, 0.25, lambda run: np.abs(run.v[-1] - truth).max() / (v1 - v2), v=(v1, v2), restitution=e
    )


SCENES = (
    BankScene(
        "F12", "trajectory", (_bounce(0.0, 1), _bounce(0.5, 2), _bounce(0.9, 5), _bounce(1.0, 10), _zeno()),
        proportional(30.0), 1,
    ),
    BankScene("F13", "one step", (_drop(),), constant(1e-6)),
    BankScene(
        "F14", "trajectory", (_bullet(0.0), _bullet(1.0)), constant(1e-3), None, (0.01, 0.005, 0.002, 0.001, 0.0005)
    ),
    BankScene("F24", "conservation", (_cradle(),), constant(1e-2)),
    BankScene("F27", "trajectory", (_two(1.0), _two(0.5)), constant(1e-3)),
)  # fmt: skip
