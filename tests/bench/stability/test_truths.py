"""The truths of the bank against independent numerics: quadrature, integration of the equations, linear systems."""

from __future__ import annotations

from math import atan, cos, sin, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from cmbrl.bench.studies.stability import bouncing, jams, motion, rolling, sliding
from cmbrl.bench.studies.stability.case import G
from cmbrl.bench.studies.stability.laws import distance_to_law
from cmbrl.contact.problem import ContactProblem


@pytest.mark.parametrize("m", [0.0, 0.3, 0.9, 0.99999])
def test_elliptic_integral(m: float) -> None:
    assert motion.elliptic_k(m) == pytest.approx(ellipk(m), rel=1e-13)


def test_flip_period_is_that_of_eulers_equations() -> None:
    I1, I2, I3 = motion.INERTIA

    def euler(_: float, w: np.ndarray) -> list[float]:
        return [(I2 - I3) / I1 * w[1] * w[2], (I3 - I1) / I2 * w[2] * w[0], (I1 - I2) / I3 * w[0] * w[1]]

    t = np.linspace(0, 100, 20001)
    w = solve_ivp(euler, (0, 100), motion.SPIN, t_eval=t, rtol=1e-12, atol=1e-14).y
    assert motion.measured_period(t, w[1]) == pytest.approx(motion.flip_period(), rel=1e-6)
    assert motion.flip_period() == pytest.approx(39.1057, abs=1e-4)


def test_tipping_box_keeps_its_energy() -> None:
    """I w^2/2 equals what the centre has fallen, and the angle is the integral of w."""
    angle, width, height = atan(0.6), 0.2, 0.4
    t = np.linspace(0, 0.3, 301)[1:]
    w = sliding.tipping(angle, width, height, t)
    turned = np.concatenate([[0], np.cumsum((np.r_[0, w[:-1]] + w) / 2 * 1e-3)])[-1]
    start = angle - atan(width / height)
    radius = sqrt(width**2 + height**2) / 2
    fallen = radius * (cos(start) - cos(start + turned))
    inertia = (width**2 + height**2) / 3
    assert 0.5 * inertia * w[-1] ** 2 == pytest.approx(G * fallen, rel=1e-4)


def test_sliding_and_rolling_paths() -> None:
    mu, v0 = 0.2, 1.0
    assert sliding.stopping_path(np.array([9.0]), mu)[0] == pytest.approx(sliding.stopping_distance(mu))
    until = 2 * v0 / (7 * mu * G)
    x = rolling.rolling_path(np.array([until, until + 1]), mu, v0)
    assert x[0] == pytest.approx(12 * v0**2 / (49 * mu * G))
    assert x[1] - x[0] == pytest.approx(5 / 7 * v0)


def test_plate_and_balls_obey_newton_and_euler() -> None:
    """Unknown: plate, ball, spin acceleration, friction at a ball; the ball rolls on the plate."""
    M, m, n, mu, F, r = 10.0, 1.0, 25, 0.4, 150.0, 0.1
    A = np.array([[M, 0, 0, n], [0, m, 0, -1], [0, 0, 0.4 * m * r**2, -r], [1, -1, -r, 0]])
    plate, ball, _, _ = np.linalg.solve(A, [F - mu * (M + n * m) * G, 0, 0, 0])
    assert rolling.plate_and_balls(M, m, n, mu, F) == pytest.approx((plate, ball))
    assert (plate, ball) == pytest.approx((0.7385, 0.211), rel=1e-3)


def test_wedge_obeys_newton() -> None:
    """Unknown: acceleration of the wedge, normal force; the blocks follow the face."""
    tangent, mu, m, M, N = 0.8, 0.4, 1.5, 2.0, 20.0
    s, c = sin(atan(tangent)), cos(atan(tangent))
    A = np.array([[M, -2 * (s - mu * c)], [m * tangent, c + mu * s]])
    a, _ = np.linalg.solve(A, [0, N])
    assert jams.thrown_out(tangent, mu, m, M, N) == pytest.approx(a)
    assert jams.thrown_out(0.4, 0.4, m, M, N) == 0


def test_painleve_impulse() -> None:
    """(2, 1.5) N s as the step goes to zero, and the tip stops."""
    vx, vz, spin = jams.painleve(5.0, 1e-12)
    assert (vx + 5, vz) == pytest.approx((2, 1.5))
    assert (vx + jams.SIN * spin, vz - jams.COS * spin) == pytest.approx((0, 0), abs=1e-9)


def test_apex_times() -> None:
    """By following the ball from bounce to bounce."""
    e, h0 = 0.7, 1.0
    t, speed = sqrt(2 * h0 / G), sqrt(2 * G * h0)
    for _ in range(3):
        speed *= e
        t += 2 * speed / G
    speed *= e  # the fourth bounce
    assert bouncing.apex_time(e, 4, h0) == pytest.approx(t + speed / G)


def sliding_mass(v: float, mu: float, h: float = 1e-3) -> ContactProblem:
    J = np.array([[[0.0, 1.0], [1.0, 0.0]]])
    free = np.array([v, -G * h])
    return ContactProblem(np.eye(2), J, free, np.zeros((1, 2)), np.array([mu]), np.zeros((1, 2)), max(v, G * h))


def test_distance_to_law_is_zero_for_the_law_alone() -> None:
    mu, h = 0.4, 1e-3
    problem = sliding_mass(1.0, mu)
    assert distance_to_law(problem, np.array([1 - mu * G * h, 0.0])) < 1e-12
    relaxed = (mu * 1.0 + G * h) / (1 + mu**2)  # what the convex relaxation gives: it lifts off with an impulse
    assert distance_to_law(problem, np.array([1 - mu * relaxed, relaxed - G * h])) > 0.3
    assert distance_to_law(problem, np.array([1.0, 0.0])) == pytest.approx(mu * G * h / np.hypot(1, G * h), rel=0.2)
    assert distance_to_law(problem, problem.v_free) == pytest.approx(G * h)  # it sinks
