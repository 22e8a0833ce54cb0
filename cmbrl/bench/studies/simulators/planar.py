"""Two planar scenes: a disc that bounces, with its closed form, and a box that is thrown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.bench.peers.simulator import Array

GRAVITY = 9.81  # [m/s^2]
INTERVAL, FILE_STEP = 0.02, 0.005  # [s]
_WIDTH, _HEIGHT = 0.1, 0.05  # half sides of the box [m]; it has a mass of 1 kg
_TEXT = """<mujoco model="{name}"><option timestep="{step}" gravity="0 0 -{gravity}"/><worldbody>
<geom name="ground" type="plane" size="50 50 1" friction="{friction}"/><body name="{name}">
<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
<geom name="{name}" {shape} friction="{friction}"/></body></worldbody></mujoco>"""


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

    def mjcf(self) -> str:
        """The disc above the ground z = 0; it has no attribute for restitution."""
        return _mjcf("ball", f'type="sphere" size="{self.radius}"', self.mass, self.inertia, self.friction)


def box_mjcf() -> str:
    """An inelastic box above the ground z = 0."""
    inertia = 1.0 * (_WIDTH**2 + _HEIGHT**2) / 3
    return _mjcf("box", f'type="box" size="{_WIDTH} 0.1 {_HEIGHT}"', 1.0, inertia, 0.4)


def thrown_discs(states: int, seed: int) -> tuple[Array, Array, int]:
    """q, v (states, 3) and the number of intervals; q = x, z, angle about +y."""
    rng = np.random.default_rng([seed, 2])
    q = np.column_stack([np.zeros(states), rng.uniform(0.2, 0.8, states), np.zeros(states)])
    v = np.column_stack([rng.uniform(-3, 3, states), rng.uniform(-2, 1, states), rng.uniform(-20, 20, states)])
    return q, v, 40


def thrown_boxes(states: int, seed: int) -> tuple[Array, Array, int]:
    """The same for a box thrown from low with a spin: it lands on a corner, slides and comes to rest."""
    rng = np.random.default_rng([seed, 3])
    q = np.column_stack([np.zeros(states), rng.uniform(0.13, 0.25, states), rng.uniform(-np.pi, np.pi, states)])
    v = np.column_stack([rng.uniform(-1.5, 1.5, states), rng.uniform(-1, 0.5, states), rng.uniform(-6, 6, states)])
    return q, v, 25


def _mjcf(name: str, shape: str, mass: float, inertia: float, friction: float) -> str:
    return _TEXT.format(
        name=name, shape=shape, mass=mass, inertia=inertia, friction=friction, step=FILE_STEP, gravity=GRAVITY
    )


def bounces(disc: Disc, q: Array, v: Array, times: Array) -> Array:
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


def _fly(q: Array, v: Array, t: float) -> Array:
    return q + t * v - np.array([0.0, 0.5 * GRAVITY * t * t, 0.0])


def _impact(disc: Disc, v: Array) -> Array:
    normal = -(1 + disc.restitution) * disc.mass * v[1]
    slip = v[0] - disc.radius * v[2]
    friction = np.clip(-disc.mass * slip / 3, -disc.friction * normal, disc.friction * normal)
    spin = v[2] - disc.radius * friction / disc.inertia
    return np.array([v[0] + friction / disc.mass, v[1] + normal / disc.mass, spin])
