"""Two planar scenes: a disc that bounces, with its closed form, and a box that is thrown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GRAVITY = 9.81  # [m/s^2]
_JOINTS = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>'
_TEXT = """<mujoco model="{name}"><option timestep="0.005" gravity="0 0 -{gravity}"/><worldbody>
<geom name="ground" type="plane" size="50 50 1" friction="{friction}"/>
<body name="{name}">{joints}<inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
<geom name="{name}" type="{kind}" size="{size}" friction="{friction}"/></body></worldbody></mujoco>"""


@dataclass(frozen=True)
class Disc:
    """SI units; inertia m r^2 / 2."""

    mass: float = 1.0
    radius: float = 0.1
    friction: float = 0.2
    restitution: float = 0.72

    @property
    def inertia(self) -> float:
        return self.mass * self.radius**2 / 2


@dataclass(frozen=True)
class Rectangle:
    """SI units; half sides; inelastic."""

    mass: float = 1.0
    half_width: float = 0.1
    half_height: float = 0.05
    friction: float = 0.4
    restitution: float = 0.0

    @property
    def inertia(self) -> float:
        return self.mass * (self.half_width**2 + self.half_height**2) / 3


def ball(states: int, seed: int) -> tuple:
    """MJCF, disc, q, v (states, 3), interval [s], intervals, step of the file [s]; q = x, z, angle about +y."""
    disc, rng = Disc(), np.random.default_rng([seed, 2])
    q = np.column_stack([np.zeros(states), rng.uniform(0.2, 0.8, states), np.zeros(states)])
    v = np.column_stack([rng.uniform(-3, 3, states), rng.uniform(-2, 1, states), rng.uniform(-20, 20, states)])
    return _mjcf("ball", "sphere", f"{disc.radius}", disc), disc, q, v, 0.02, 40, 0.005


def box(states: int, seed: int) -> tuple:
    """The same for a box thrown from low with a spin: it lands on a corner, slides and comes to rest."""
    body, rng = Rectangle(), np.random.default_rng([seed, 3])
    q = np.column_stack([np.zeros(states), rng.uniform(0.13, 0.25, states), rng.uniform(-np.pi, np.pi, states)])
    v = np.column_stack([rng.uniform(-1.5, 1.5, states), rng.uniform(-1, 0.5, states), rng.uniform(-6, 6, states)])
    size = f"{body.half_width} 0.1 {body.half_height}"
    return _mjcf("box", "box", size, body), body, q, v, 0.02, 25, 0.005


def _mjcf(name: str, kind: str, size: str, body: Disc | Rectangle) -> str:
    return _TEXT.format(
        name=name, kind=kind, size=size, joints=_JOINTS, mass=body.mass, inertia=body.inertia, friction=body.friction,
        gravity=GRAVITY,
    )  # fmt: skip


def bounces(disc: Disc, q: np.ndarray, v: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Closed form: configurations (n, len(times), 3) of discs thrown at t = 0 from q, v (n, 3) onto the ground z = 0.

    Parabolas between impacts; an impact reverses the normal velocity times the restitution, and friction, at most mu
    times the normal impulse P, stops the slip v_x - r w of the lowest point or as much of it as it can:
    P = (1 + e) m v_n and a sticking tangential impulse of -m s / 3 for a disc.
    """
    out = np.empty((len(q), len(times), 3))
    for row in range(len(q)):
        x, speed, clock, k = q[row].copy(), v[row].copy(), 0.0, 0
        while k < len(times):
            height = max(x[1] - disc.radius, 0.0)
            fall = (speed[1] + np.sqrt(speed[1] ** 2 + 2 * GRAVITY * height)) / GRAVITY  # until the next impact
            while k < len(times) and times[k] <= clock + fall:
                out[row, k] = _fly(x, speed, times[k] - clock)
                k += 1
            x, clock = _fly(x, speed, fall), clock + fall
            speed = _impact(disc, speed - [0.0, GRAVITY * fall, 0.0])
            if speed[1] < 1e-6:
                raise ValueError("the ball comes to rest within the horizon: Zeno point")
    return out


def _fly(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    return q + t * v - np.array([0.0, 0.5 * GRAVITY * t * t, 0.0])


def _impact(disc: Disc, v: np.ndarray) -> np.ndarray:
    normal = -(1 + disc.restitution) * disc.mass * v[1]
    slip = v[0] - disc.radius * v[2]
    friction = np.clip(-disc.mass * slip / 3, -disc.friction * normal, disc.friction * normal)
    spin = v[2] - disc.radius * friction / disc.inertia
    return np.array([v[0] + friction / disc.mass, v[1] + normal / disc.mass, spin])
