"""The bounds of the ABS paper on one contact, and how much they say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from cmbrl.contact import Barrier, Gaussian
from cmbrl.contact.smoothing import Smoothing

from .conftest import F, H, ScalarLaw

Law = Callable[[Smoothing], ScalarLaw]


def fit_residual(z: float, s: float) -> float:
    """Root mean square of max(-(z + w), 0)/F less its best line in w, w normal with deviation s."""
    moments = [
        quad(lambda w, k=k: w**k * max(-(z + w), 0) / F * norm.pdf(w, scale=s), -12 * s, -z, epsabs=1e-14)[0]
        for k in range(2)
    ]
    square = quad(lambda w: (max(-(z + w), 0) / F) ** 2 * norm.pdf(w, scale=s), -12 * s, -z, epsabs=1e-14)[0]
    return float(np.sqrt(max(square - moments[0] ** 2 - moments[1] ** 2 / s**2, 0.0)))


def test_slope_is_the_best_linear_fit(law: Law) -> None:
    """Proposition 5.3: value and slope of the Gaussian schedule are the least-squares line of the hard under noise."""
    s = 0.2
    for z in (-0.3, 0.0, 0.15):
        impulse, slope = law(Gaussian(s * H, floor=1e-15))(np.array([z]))
        value = quad(lambda w, z=z: max(-(z + w), 0) / F * norm.pdf(w, scale=s), -12 * s, -z)[0]
        line = quad(lambda w, z=z: w * max(-(z + w), 0) / F * norm.pdf(w, scale=s), -12 * s, -z)[0] / s**2
        assert impulse[0] == pytest.approx(value, rel=1e-5)
        assert slope[0] == pytest.approx(line, rel=1e-5)


def test_gradient_bias_is_bounded(law: Law) -> None:
    """Theorem 5.4: |S' - S_0'| <= 1/F + (12 eps + zeta)/(s Q), Q = .43; C = D = 1 here.

    The caution: both slopes lie in [-1/F, 0], so that 1/F bounds their difference without any theorem. What is sharp is
    Phi(-|z|/s)/F, which the last lines assert.
    """
    s = 0.2
    z = np.array([-0.5, -0.1, -0.01, 0.01, 0.1, 0.5])
    slope = law(Gaussian(s * H, floor=1e-15))(z)[1]
    bias = np.abs(slope - np.where(z < 0, -1 / F, 0.0))
    zeta = s * norm.pdf(0) / F
    bound = np.array([1 / F + (12 * fit_residual(x, s) + zeta) / (s * 0.43) for x in z])
    assert (bias <= bound).all()
    assert (bias <= 1 / F).all()
    np.testing.assert_allclose(bias, norm.cdf(-np.abs(z) / s) / F, atol=1e-6 / F)


@pytest.mark.parametrize("kappa", [1e-6, 1e-3])
def test_inactive_contacts(kappa: float, law: Law) -> None:
    """Theorem 5.1: lambda <= kappa/z and |slope| <= kappa/z^2 where z > 0."""
    z = np.geomspace(1e-3, 2, 25)
    impulse, slope = law(Barrier(kappa))(z)
    assert (impulse <= kappa / z * (1 + 1e-9)).all()
    assert (np.abs(slope) <= kappa / z**2 + 1e-9).all()


@pytest.mark.parametrize("kappa", [1e-6, 1e-3])
def test_lipschitz_constant_of_the_impulse(kappa: float, law: Law) -> None:
    """Theorem 4.5, l(kappa) for one contact, with its loosest reading, lies far above the true constant 1/F."""
    z = np.linspace(-1, 1, 101)
    slope = np.abs(law(Barrier(kappa))(z)[1])
    e2 = 1.0
    a = e2 / (2 * kappa * F**2)
    bound = a + 1 / F + a * np.sqrt(1 + 4 * kappa * F / e2)
    assert slope.max() <= 1 / F + 1e-9
    assert bound > 100 / F  # the bound grows like 1/kappa, the slope does not
