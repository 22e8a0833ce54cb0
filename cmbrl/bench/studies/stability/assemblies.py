"""Boxes on boxes, a gripper, cylinders and chains of free bodies: what robots handle. F31 to F36 and F39 of
the bank."""

from __future__ import annotations

from math import atan, cos, degrees, pi, sin, sqrt

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant, resting, unrest
from cmbrl.bench.studies.stability.worlds import GROUND, body, box, sphere, tilted, world

HALF, RADIUS = 0.05, 0.1  # of cubes and cylinders [m]
SETTLE = 0.5  # [s]


def _stack(count: int) -> Case:
    """Cubes on each other, four corners a contact: nothing moves."""
    cubes = [body(f"cube{k}", (0, 0, HALF * (1 + 2 * k)), "f", box(f"cube{k}", (HALF,) * 3)) for k in range(count)]
    return Case(f"{count} cubes", world(GROUND, *cubes, mu=0.5), SETTLE, lambda run: unrest(run, HALF))


def _ridge() -> Case:
    """A plank lies in balance across the edge of a box that stands on its edge: nothing moves."""
    ridge = f'<geom type="box" size="{HALF} {HALF} {HALF}" euler="0 45 0" pos="0 0 {HALF * sqrt(2)}"/>'
    thick = 0.02
    plank = body("plank", (0, 0, 2 * sqrt(2) * HALF + thick), "f", box("plank", (0.3, 0.1, thick)))
    return Case("plank across an edge", world(ridge, plank, mu=0.5), 0.2, lambda run: unrest(run, HALF))


def _gripper(share: float) -> Case:
    """Two flat pads squeeze a free cube with N each: it holds if 2 mu N >= m g, else falls with g - 2 mu N/m."""
    m, mu = 0.5, 0.6
    N = share * m * G / (2 * mu)
    a = max(0.0, G - 2 * mu * N / m)
    pads = [
        body(f"pad{k}", (s * (HALF + 0.02), 0, 0), "x", box(f"pad{k}", (0.02, 0.1, 3.0), 0.3))
        for k, s in enumerate((1, -1))
    ]
    cube = body("cube", (0, 0, 0), "f", box("cube", (HALF,) * 3, m))
    return Case(
        f"2 mu N = {share:g} m g", world(cube, *pads, mu=mu, motors=("pad0_x", "pad1_x")), 0.3,
        lambda run: np.abs(run.v[-1, :6] + np.array([0, 0, a * run.t[-1], 0, 0, 0])).max() / (G * run.t[-1]),
        control=(-N, N),
    )  # fmt: skip


def _rolling(tangent: float, mu: float) -> Case:
    """A solid cylinder on an incline: a = 2/3 g sin while tan <= 3 mu, else it slides with g (sin - mu cos)."""
    angle = atan(tangent)
    a = 2 / 3 * G * sin(angle) if tangent <= 3 * mu else G * (sin(angle) - mu * cos(angle))
    alpha = a / RADIUS if tangent <= 3 * mu else 2 * mu * G * cos(angle) / RADIUS

    def error(run: Run) -> float:
        t, v = run.t[-1], run.v[-1]
        return float(max(abs(v[0] - a * t), abs(v[4] - alpha * t) * RADIUS, abs(v[1])) / (G * sin(angle) * t))

    roll = body("roll", (0, 0, RADIUS), "f", f'<geom type="cylinder" size="{RADIUS} 0.15" euler="90 0 0" mass="1"/>')
    mjcf = world(GROUND, roll, mu=mu, gravity=tilted(angle))
    return Case(f"tan {tangent:g}, mu {mu:g}", mjcf, 0.5, error)


def _wedged(opening: float, share: float) -> Case:
    """A wheel lies in a groove and its motor turns it: it holds up to a torque, beyond which it spins in place.

    Both flanks, of slope b, slide at once, with N1 + N2 = m g/(cos b (1 + mu^2)) and torque mu r (N1 + N2).
    """
    m, mu, slope = 1.0, 0.4, pi / 2 - opening / 2
    most = mu * m * G * RADIUS / (cos(slope) * (1 + mu**2))
    alpha = max(0.0, share - 1) * most / (m * RADIUS**2 / 2)
    flanks = "".join(
        f'<geom type="plane" size="5 5 1" zaxis="{s * sin(slope):.15g} 0 {cos(slope):.15g}"/>' for s in (1, -1)
    )
    wheel = f'<geom type="cylinder" size="{RADIUS} 0.05" euler="90 0 0" mass="{m}"/>'
    mjcf = world(flanks, body("wheel", (0, 0, RADIUS / cos(slope)), "xzr", wheel), mu=mu, motors=("wheel_r",))

    def error(run: Run) -> float:
        t, (x, z, spin) = run.t[-1], run.v[-1]
        return float(max(abs(x), abs(z), abs(spin - alpha * t) * RADIUS) / (G * t))

    name = f"groove of {degrees(opening):.0f} degrees, {share:g} of the largest torque"
    return Case(name, mjcf, 0.2, error, control=(share * most,))


def _hanging(links: int) -> Case:
    """Free balls in a row, each tied to the next by a point, hang from the world: they stay in place."""
    length, names = 0.05, [f"ball{k}" for k in range(links)]
    alone = 'contype="0" conaffinity="0"'
    balls = [body(n, (0, 0, -length * (k + 1)), "f", sphere(n, 0.01, 0.1, alone)) for k, n in enumerate(names)]
    hard = 'solref="0.001 1" solimp="0.9999 0.9999 0.001"'
    ties = "".join(
        f'<connect body1="{n}" body2="{above}" anchor="0 0 {length}" {hard}/>'
        for n, above in zip(names, ["world", *names[:-1]], strict=True)
    )
    mjcf = world(*balls).replace("</worldbody>", f"</worldbody><equality>{ties}</equality>")
    return Case(
        f"{links} ties", mjcf, SETTLE, lambda run: np.abs(run.q[-1] - run.q[0]).max() / (links * length), contacts=False
    )


def _packed(side: int) -> Case:
    """``side`` cubed balls, 10 mm apart, fall onto a plane and onto each other: none enters another, or the plane.

    After the test of 6 x 6 x 6 balls in SimBenchmark (Kang and Hwangbo, leggedrobotics.github.io/SimBenchmark).
    """
    radius, apart, draw = 0.5, 1.01, np.random.default_rng(0)
    grid = np.array([(i, j, k) for k in range(side) for i in range(side) for j in range(side)])
    places = apart * grid + (0, 0, apart - radius)
    places[:, :2] += draw.uniform(-0.005, 0.005, (len(grid), 2))
    balls = [body(f"ball{k}", tuple(at), "f", sphere(f"ball{k}", radius)) for k, at in enumerate(places)]

    def error(run: Run) -> float:
        centres = run.q.reshape(len(run.q), -1, 7)[1:, :, :3]
        first, second = np.triu_indices(len(grid), 1)
        between = np.linalg.norm(centres[:, first] - centres[:, second], axis=2)
        return float(max(0.0, (2 * radius - between).max(), (radius - centres[:, :, 2]).max()) / radius)

    return Case(f"{len(grid)} balls", world(GROUND, *balls, mu=0.8), 0.5, error)


SCENES = (
    BankScene("F31", "one step", (_stack(10),), resting),
    BankScene("F32", "one step", (_ridge(),), resting),
    BankScene("F33", "trajectory", tuple(_gripper(s) for s in (1.5, 1.01, 0.9)), constant(1e-4)),
    BankScene("F34", "trajectory", (_rolling(0.3, 0.4), _rolling(1.0, 0.2)), constant(1e-4)),
    BankScene("F35", "trajectory", tuple(_wedged(a, s) for a in (pi / 2, pi / 3) for s in (0.99, 1.1)), constant(1e-4)),
    BankScene("F36", "one step", (_hanging(30),), constant(1e-2)),
    BankScene("F39", "residual", (_packed(4),), constant(1e-4), steps=(0.02, 0.01, 0.005)),
)  # fmt: skip
