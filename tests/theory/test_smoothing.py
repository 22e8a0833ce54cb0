"""Barrier smoothing is randomised smoothing, with which density; and the schedule that makes it Gaussian."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm, t

from cmbrl.contact import Barrier, Gaussian
from cmbrl.contact.smoothing import Smoothing

from .conftest import F, H, ScalarLaw

Law = Callable[[Smoothing], ScalarLaw]
Z = np.array([-1.2, -0.3, -0.05, 0.0, 0.02, 0.1, 0.7])


def density(w: float, kappa: float) -> float:
    """2 F kappa/(w^2 + 4 F kappa)^(3/2): F times the curvature of the softened law."""
    return 2 * F * kappa / (w * w + 4 * F * kappa) ** 1.5


@pytest.mark.parametrize("kappa", [1e-4, 1e-2])
def test_density_is_student_t(kappa: float) -> None:
    """2 degrees of freedom and scale sqrt(2 F kappa): a probability density without a variance."""
    w = np.linspace(-1, 1, 9)
    np.testing.assert_allclose(density(w, kappa), t.pdf(w, df=2, scale=np.sqrt(2 * F * kappa)), rtol=1e-12)


@pytest.mark.parametrize("kappa", [1e-4, 1e-2])
def test_barrier_is_randomised_smoothing(kappa: float, law: Law) -> None:
    """Proposition 5.2 of Zhang, Jin & Wang (2023): S_kappa(z) = E S_0(z + w), S_0(z) = max(-z, 0)/F; slopes too."""
    impulse, slope = law(Barrier(kappa))(Z)
    for k, z in enumerate(Z):
        expected = quad(lambda w, z=z: -(z + w) / F * density(w, kappa), -np.inf, -z, epsabs=1e-13, epsrel=1e-11)[0]
        assert impulse[k] == pytest.approx(expected, rel=1e-7)
        expected = -quad(density, -np.inf, -z, args=(kappa,), epsabs=1e-13, epsrel=1e-11)[0] / F
        assert slope[k] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_barrier_is_randomised_smoothing_of_our_own_hard_law(law: Law) -> None:
    """The same with the hard law solved by the core under 20,000 quantiles of the density in place of an integral."""
    kappa = 1e-2
    quantiles = t.ppf((np.arange(20000) + 0.5) / 20000, df=2, scale=np.sqrt(2 * F * kappa))
    hard, soft = law(Barrier(1e-13)), law(Barrier(kappa))
    for z in (-0.3, 0.0, 0.1):
        assert hard(z + quantiles)[0].mean() == pytest.approx(soft(np.array([z]))[0][0], rel=1e-2)
        assert hard(z + quantiles)[1].mean() == pytest.approx(soft(np.array([z]))[1][0], rel=1e-3)


@pytest.mark.parametrize("length", [1e-3, 5e-3])
def test_gaussian_schedule_is_gaussian_smoothing_in_value_and_slope(length: float, law: Law) -> None:
    """Proposition 5.3 in closed form: rho(z) = (s N(z/s) - z Phi(-z/s))/F and rho'(z) = -Phi(-z/s)/F, s = length/h."""
    s = length / H
    z = np.linspace(-4, 4, 33) * s
    impulse, slope = law(Gaussian(length, floor=1e-15))(z)
    np.testing.assert_allclose(impulse, (s * norm.pdf(z / s) - z * norm.cdf(-z / s)) / F, rtol=1e-5)
    np.testing.assert_allclose(slope, -norm.cdf(-z / s) / F, atol=1e-6 / F)


def test_schedule_of_kappa(law: Law) -> None:
    """kappa(z) = F rho(z) rho(-z), read off the core as impulse times end speed: even, peak s^2/(2 pi F) at z = 0."""
    s, z = 0.3, np.array([-0.5, -0.1, 0.0, 0.1, 0.5])
    impulse = law(Gaussian(s * H, floor=1e-15))(z)[0]
    kappa = impulse * (z + F * impulse)
    np.testing.assert_allclose(kappa, kappa[::-1], rtol=1e-6)
    assert kappa[2] == pytest.approx(s**2 / (2 * np.pi * F), rel=1e-6)


def test_derivative_with_and_without_the_schedule(law: Law) -> None:
    """Finite differences agree with the exact option; stop-gradient misses d lambda/d kappa times kappa'(z)."""
    s, step = 0.3, 1e-5
    z = np.linspace(-0.6, 0.6, 13)
    exact, stopped = (law(Gaussian(s * H, floor=1e-15, derivative=d)) for d in ("exact", "stop"))
    differences = (exact(z + step)[0] - exact(z - step)[0]) / (2 * step)
    np.testing.assert_allclose(exact(z)[1], differences, atol=1e-6)
    rho, cdf = exact(z)[0], norm.cdf(-z / s)
    kappa = rho * (z + F * rho)
    kappa_slope = -cdf / F * (z + F * rho) + rho * (1 - cdf)
    missing = kappa_slope / np.sqrt(z**2 + 4 * F * kappa)
    np.testing.assert_allclose(stopped(z)[1], exact(z)[1] - missing, atol=1e-6)
    assert np.abs(missing).max() > 0.05 / F  # not a technicality
