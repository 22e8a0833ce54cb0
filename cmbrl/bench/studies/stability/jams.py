"""Friction that locks, and problems with no or several solutions: Painleve's rod, slots, wedges. F15, F16, F17, F19."""

from __future__ import annotations

from math import atan, cos, degrees, sqrt, tan

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant, resting
from cmbrl.bench.studies.stability.laws import law_error
from cmbrl.bench.studies.stability.worlds import GROUND, body, box, sphere, world

TIP = 1e-8  # radius of the sphere that stands for the rod's tip [m]
COS, SIN = 1 / sqrt(5), 2 / sqrt(5)  # of the rod's angle with the ground, tan = 2
INERTIA = 1 / 3  # of a uniform rod of mass 1 and half-length 1 about its centre [kg m^2]


def painleve(speed: float, h: float) -> np.ndarray:
    """v' (x, z, spin about -y) of the jam: the tip stops in both directions, J v' = 0 (Painleve; Genot and Brogliato).

    The tip lies at (-cos, -sin) from the centre and slides towards -x at ``speed``."""
    J = np.array([[1, 0, SIN], [0, 1, -COS]])  # of the tip's velocity in (v_x, v_z, w), w turning x towards z
    M = np.diag([1, 1, INERTIA])
    free = np.array([-speed, -G * h, 0])
    impulse = np.linalg.solve(J @ np.linalg.solve(M, J.T), -J @ free)
    return free + np.linalg.solve(M, J.T @ impulse)


def _rod(mu: float) -> str:
    inertia = f'<inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>'
    tip = f'<geom name="tip" type="sphere" size="{TIP}" pos="{-COS:.15g} 0 {-SIN:.15g}"/>'
    return world(GROUND, body("rod", (0, 0, SIN + TIP), "xzr", inertia + tip), mu=mu)


def _painleve(mu: float) -> Case:
    """lambda = (2, 1.5) N s as h -> 0 for every mu >= 4/3."""
    speed = 5.0

    def error(run: Run) -> float:
        vx, vz, spin = painleve(speed, run.h)
        return float(np.abs(run.v[1] - np.array([vx, vz, -spin])).max() / speed)

    return Case(f"mu = {mu:g}", _rod(mu), 0.0, error, v=(-speed, 0, 0))


def _lifting() -> Case:
    """The same tip speed, but the tip would lift at 1 m/s: separation, sliding and jam all solve the law."""
    spin = -1 / COS  # turns x towards z: the tip's normal speed is -cos w = 1
    v = (-5.0 - SIN * spin, 0.0, -spin)
    return Case("tip lifts at 1 m/s, mu = 3", _rod(3.0), 0.0, law_error, v=v)


def _slot() -> Case:
    """Both walls 1 mm too near: rigid rows ask for u >= 1 and u <= -1 m/s; by symmetry, v = 0 is all that is left."""
    radius, tight = 0.1, 1e-3
    walls = "".join(
        f'<geom name="wall{k}" type="plane" size="5 5 1" pos="{-s * (radius - tight):.15g} 0 0" zaxis="{s} 0 0"/>'
        for k, s in enumerate((1, -1))
    )
    mjcf = world(walls, body("slider", (0, 0, 0), "x", sphere("slider", radius)), gravity=(0, 0, 0))
    return Case("1 mm too tight on both sides", mjcf, 0.0, lambda run: abs(run.v[1, 0]) * run.h / tight)


def thrown_out(tangent: float, mu: float, m: float, M: float, N: float) -> float:
    """Acceleration [m/s^2] of a wedge M of half-angle a that blocks m squeeze with N each: none if tan a <= mu, else
    N/(m tan a + M/(2 tan(a - atan mu))) (both faces slide; Newton for wedge and blocks)."""
    return N / (m * tangent + M / (2 * tan(atan(tangent) - atan(mu)))) if tangent > mu else 0.0


def _wedge(tangent: float, mu: float) -> Case:
    m, M, N, angle, radius, half = 1.0, 1.0, 20.0, atan(tangent), 0.1, (0.05, 0.5, 0.5)
    a = thrown_out(tangent, mu, m, M, N)
    faces = "".join(
        box(f"face{k}", half, M / 2, f'pos="{s * half[0]} 0 0" euler="0 {s * degrees(angle):.15g} 0"')
        for k, s in enumerate((1, -1))
    )
    reach = half[0] + (radius + half[0]) / cos(angle)  # where a block touches at the height of the wedge's origin
    blocks = [body(f"block{k}", (s * reach, 0, 0), "x", sphere(f"block{k}", radius, m)) for k, s in enumerate((1, -1))]
    mjcf = world(
        body("wedge", (0, 0, 0), "z", faces), *blocks, mu=mu, gravity=(0, 0, 0), motors=("block0_x", "block1_x")
    )
    return Case(
        f"tan = {tangent:g}, mu = {mu:g}", mjcf, 0.1,
        lambda run: abs(run.v[-1, 0] - a * run.t[-1]) / (N / M * run.t[-1]), control=(-N, N),
    )  # fmt: skip


SCENES = (
    BankScene("F15", "one step", (_painleve(1.4), _painleve(2.0), _painleve(5.0)), resting),
    BankScene("F16", "residual", (_lifting(),), resting),
    BankScene("F17", "one step", (_slot(),), constant(1e-6)),
    BankScene(
        "F19", "trajectory", (_wedge(0.3, 0.6), _wedge(0.495, 0.5), _wedge(0.505, 0.5), _wedge(0.8, 0.4)),
        constant(1e-4),
    ),
)  # fmt: skip
