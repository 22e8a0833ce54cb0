"""What kappa does to one contact, in closed form: stiffness, hover, creep, force at a distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel

from .conftest import GRAVITY, MASS, F, H, ScalarLaw

KAPPAS = (1e-8, 1e-6, 1e-4, 1e-2)
Law = Callable[[Barrier], ScalarLaw]
Point = Callable[..., ComplementarityModel]


@pytest.mark.parametrize("kappa", KAPPAS)
def test_impulse_and_slope(kappa: float, law: Law) -> None:
    """lambda = (-z + sqrt(z^2 + 4 F kappa))/(2F) and its slope -(1 - z/sqrt(z^2 + 4 F kappa))/(2F)."""
    z = np.linspace(-2, 2, 41)
    impulse, slope = law(Barrier(kappa))(z)
    root = np.sqrt(z**2 + 4 * F * kappa)
    # the stable form of (root - z)/(2F): 2 kappa/(z + root) where z > 0
    np.testing.assert_allclose(impulse, np.where(z > 0, 2 * kappa / (z + root), (root - z) / (2 * F)), rtol=1e-7)
    np.testing.assert_allclose(slope, -(1 - z / root) / (2 * F), atol=1e-7 / F)


@pytest.mark.parametrize("kappa", KAPPAS)
def test_slope_is_bounded_whatever_kappa(kappa: float, law: Law) -> None:
    """G9: slopes lie in [-1/F, 0] and are -1/(2F) at z = 0 for every kappa: softness does not tame them."""
    z = np.concatenate([[0.0], np.geomspace(1e-6, 10, 30), -np.geomspace(1e-6, 10, 30)])
    slope = law(Barrier(kappa))(z)[1]
    assert slope[0] == pytest.approx(-1 / (2 * F), rel=1e-7)
    assert slope.min() >= -1 / F - 1e-7
    assert slope.max() <= 1e-7


@pytest.mark.parametrize("kappa", KAPPAS)
def test_curvature_grows_like_one_over_root_kappa(kappa: float, law: Law) -> None:
    """Curvature 2 kappa/(z^2 + 4 F kappa)^(3/2), largest at z = 0: 1/(4 F^(3/2) sqrt(kappa))."""
    width = np.sqrt(F * kappa)
    z = np.linspace(-6, 6, 25) * width
    step = 1e-3 * width
    slopes = law(Barrier(kappa))
    curvature = (slopes(z + step)[1] - slopes(z - step)[1]) / (2 * step)
    np.testing.assert_allclose(curvature, 2 * kappa / (z**2 + 4 * F * kappa) ** 1.5, rtol=1e-4)
    assert np.argmax(curvature) == 12
    assert curvature.max() == pytest.approx(1 / (4 * F**1.5 * np.sqrt(kappa)), rel=1e-4)


@pytest.mark.parametrize("h", [1e-3, 1e-2])
def test_hover(h: float, point: Point) -> None:
    """F30: a resting mass comes to rest at kappa/(m g), whatever the step."""
    kappa = 1e-2
    model = point(Barrier(kappa), h=h, substeps=int(3 / h))
    r = model.predict(np.array([[0, 0, 1e-3]]), np.zeros((1, 3)), np.zeros((1, 1)))
    assert r.q_next[0, 2] == pytest.approx(kappa / (MASS * GRAVITY), rel=1e-5)
    assert r.v_next[0, 2] == pytest.approx(0, abs=1e-8)


def test_impulse_and_pull_at_a_distance(point: Point) -> None:
    """lambda = kappa/(phi/h + u_n) and, with no force to speak of, a slope near -kappa/z^2: bias that decays slowly."""
    kappa, gap = 1e-6, np.array([0.02, 0.05, 0.2])
    q = np.column_stack([0 * gap, 0 * gap, gap])
    r = point(Barrier(kappa)).predict(q, 0 * q, np.zeros((3, 1)), jacobian=True)
    impulse = point(Barrier(kappa)).predict(q, 0 * q, np.zeros((3, 1)), impulse=True).impulse[:, 0, 0]
    np.testing.assert_allclose(impulse, kappa / (gap / H + r.v_next[:, 2]), rtol=1e-8)
    z = gap / H - GRAVITY * H
    np.testing.assert_allclose(MASS * (r.jacobian[:, 5, 5] - 1), -kappa / z**2, rtol=1e-5)
    np.testing.assert_allclose(r.v_next[:, 2] + GRAVITY * H, F * kappa / z, rtol=1e-5)


@pytest.mark.parametrize("kappa", [1e-9, 1e-7])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_creep_of_a_sticking_contact(share: float, kappa: float, point: Point) -> None:
    """F5, G13: u_t = -kappa beta/((mu gamma)^2 - beta^2) under a load below the threshold, with its spurious slope.

    At rest on its hover height the contact carries gamma = m g h and beta = -F h, so both are known.
    """
    mu, gamma = 0.5, MASS * GRAVITY * H
    most = mu * gamma
    beta = -share * most
    model = point(Barrier(kappa), mu=mu, substeps=40)
    q, u = np.array([[0, 0, kappa / (MASS * GRAVITY)]]), np.array([[-beta / H]])
    r = model.predict(q, np.zeros((1, 3)), u)  # long enough for the creep to be steady
    creep = -kappa * beta / (most**2 - beta**2)
    assert r.v_next[0, 0] == pytest.approx(creep, rel=1e-4)
    end = point(Barrier(kappa), mu=mu).predict(r.q_next, r.v_next, u, jacobian=True)
    slope = kappa * (most**2 + beta**2) / (most**2 - beta**2) ** 2
    steady = end.jacobian[0, 3, 6] / (1 - end.jacobian[0, 3, 3])  # of the fixed point of v' = f(v, u)
    assert steady == pytest.approx(slope * H, rel=1e-4)
