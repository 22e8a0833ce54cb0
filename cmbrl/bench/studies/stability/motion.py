"""Motion without contact, with one, with many; and contact that only just touches. F25, F28, F29 of the bank."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, Case, G, Run, constant, proportional, resting, unrest
from cmbrl.bench.studies.stability.laws import momenta
from cmbrl.bench.studies.stability.worlds import GROUND, body, box, sphere, world

INERTIA = np.array([1.0, 2.0, 3.0])  # [kg m^2]
SPIN = np.array([0.01, 1.0, 0.01])  # [rad/s]


def elliptic_k(parameter: float) -> float:
    """Complete elliptic integral of the first kind K(m), m = k^2, by the arithmetic-geometric mean."""
    a, b = 1.0, sqrt(1 - parameter)
    while abs(a - b) > 1e-15 * a:
        a, b = (a + b) / 2, sqrt(a * b)
    return float(np.pi / (2 * a))


def flip_period(inertia: np.ndarray = INERTIA, spin: np.ndarray = SPIN) -> float:
    """Period [s] of the angular velocity of a free body that spins about its middle axis, L^2 > 2 T I2
    (Landau and Lifshitz, Mechanics, section 37): P = 4 K(k^2) sqrt(I1 I2 I3/((I3 - I2)(L^2 - 2 T I1)))."""
    I1, I2, I3 = inertia
    twice, square = float(inertia @ spin**2), float((inertia**2) @ spin**2)
    k2 = (I2 - I1) * (2 * I3 * twice / 2 - square) / ((I3 - I2) * (square - twice * I1))
    return 4 * elliptic_k(k2) * sqrt(I1 * I2 * I3 / ((I3 - I2) * (square - twice * I1)))


def _spinning(T: float, error: Callable[[Run], float]) -> Case:
    inertia = (
        f'<inertial pos="0 0 0" mass="1" diaginertia="{INERTIA[0]} {INERTIA[1]} {INERTIA[2]}"/>'
        '<geom type="sphere" size="0.1" contype="0" conaffinity="0"/>'
    )
    mjcf = world(body("block", (0, 0, 5), "f", inertia), gravity=(0, 0, 0))
    return Case(f"{T:g} s", mjcf, T, error, v=(0, 0, 0, *SPIN), samples=2000, contacts=False)


def period_error(run: Run) -> float:
    """Of the flips, relative."""
    return float(abs(measured_period(run.t, run.v[:, 4]) / flip_period() - 1))


def drift(run: Run) -> float:
    """Of energy and of the size of the angular momentum, relative; the worst over the run."""
    w = run.v[:, 3:]
    energy, momentum = (INERTIA * w**2).sum(axis=1), np.linalg.norm(INERTIA * w, axis=1)
    return float(max(np.abs(energy / energy[0] - 1).max(), np.abs(momentum / momentum[0] - 1).max()))


def _tumbling() -> Case:
    """Three links tumble freely: linear momentum, and angular about the centre of mass, the worse of the two."""
    rod = '<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05" mass="1" contype="0" conaffinity="0"/>'
    links = (
        f'<body pos="0.4 0 0"><joint type="hinge" axis="0 1 0"/>{rod}'
        f'<body pos="0.4 0 0"><joint type="hinge" axis="0 0 1"/>{rod}</body></body>'
    )

    def error(run: Run) -> float:
        linear, angular = momenta(run)
        shares = [np.linalg.norm(x - x[0], axis=1).max() / np.linalg.norm(x[0]) for x in (linear, angular)]
        return float(max(shares))

    mjcf = world(body("root", (0, 0, 5), "f", rod + links), gravity=(0, 0, 0))
    start = (0.3, 0.2, 0.1, 0.2, 1.0, 0.5, 0.5, -0.5)
    return Case("100 s", mjcf, 100.0, error, v=start, samples=2000, contacts=False)


def measured_period(t: np.ndarray, w: np.ndarray) -> float:
    """Time between the first and third change of sign of w (n,), linear in between; nan without three of them."""
    k = np.flatnonzero(np.diff(np.sign(w)) != 0)
    if len(k) < 3:
        return float("nan")
    at = t[k] - w[k] * (t[k + 1] - t[k]) / (w[k + 1] - w[k])
    return float(at[2] - at[0])


def _fall() -> Case:
    """A cube far above the ground falls as if there were none: v = v0 - g t, the spin and all else untouched."""
    half, T = 0.1, 0.2
    cube = body("cube", (0, 0, 5), "f", box("cube", (half, half, half)))

    def error(run: Run) -> float:
        truth = np.zeros(6)
        truth[[0, 2, 5]] = 1.0, 2.0 - G * run.t[-1], 3.0
        return float(np.abs(run.v[-1] - truth).max() / (G * run.t[-1]))

    return Case("none near", world(GROUND, cube, mu=0.4), T, error, v=(1, 0, 2, 0, 0, 3))


def _many() -> Case:
    """Twelve feet under a plate, 36 rows for 6 degrees of freedom: at rest."""
    feet = "".join(
        f'<geom type="sphere" size="0.05" pos="{0.4 * (i - 1.5):.15g} {0.4 * (j - 1):.15g} -0.05" mass="0.5"/>'
        for i in range(4)
        for j in range(3)
    )
    mjcf = world(GROUND, body("plate", (0, 0, 0.1), "f", feet), mu=0.4)
    return Case("36 rows on 6 dofs", mjcf, 0.2, lambda run: unrest(run, 0.1))


def _graze() -> Case:
    """Gap 0, approach 0, no load: no impulse, so the ball keeps its velocity."""
    radius = 0.1
    mjcf = world(GROUND, body("ball", (0, 0, radius), "xzr", sphere("ball", radius)), mu=0.4, gravity=(0, 0, 0))
    return Case(
        "gap 0, speed 0", mjcf, 0.0, lambda run: np.abs((run.v[1] - run.v[0]) * (1, 1, radius)).max(), v=(1, 0, 0)
    )


def kappa_at_touch(h: float) -> float:
    """sqrt(kappa/G) of a unit mass at the default kappa = 1e-9 m g h * 1 m/s: what a graze costs [m/s]."""
    return sqrt(1e-9 * G * h)


SCENES = (
    BankScene("F25", "trajectory", (_spinning(100.0, period_error),), proportional(2.0), 1),
    BankScene("F25b", "conservation", (_spinning(100.0, drift),), constant(1e-3)),
    BankScene("F25c", "conservation", (_tumbling(),), constant(1e-3)),
    BankScene("F28", "one step", (_graze(),), lambda h: 10 * kappa_at_touch(h)),
    BankScene("F29", "one step", (_fall(), _many()), resting),
)  # fmt: skip
