"""Estimators against functions whose smoothed gradient is known in closed form (G5, G6), and each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from scipy.stats import norm
from torch import Tensor

from cmbrl.gradients import finite_differences, first_order_bundle, pathwise, zeroth_order_bundle

STD, THETA = 0.5, np.array([0.2])
TRUTH = norm.pdf(THETA[0], scale=STD)  # of E 1[theta + w > 0]


@dataclass(frozen=True)
class Function:
    f: Callable[[Tensor], Tensor]
    steps: int = 3

    def __call__(self, x: Tensor) -> Tensor:
        return self.f(x)


def ramp(width: float) -> Function:
    return Function(lambda x: torch.clamp(x[:, 0] / width + 0.5, 0, 1))


HEAVISIDE = Function(lambda x: (x[:, 0] > 0).double())


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_heaviside(rng: np.random.Generator) -> None:
    """G5: first order is identically 0, without a variance to warn; zeroth order is unbiased."""
    first = first_order_bundle(HEAVISIDE, THETA, STD, 1000, rng)
    assert first.mean[0] == 0
    assert first.variance[0] == 0
    zeroth = zeroth_order_bundle(HEAVISIDE, THETA, STD, 20000, rng)
    assert abs(zeroth.mean[0] - TRUTH) < 4 * zeroth.standard_error
    assert zeroth.standard_error < 0.02


def test_steep_ramp(rng: np.random.Generator) -> None:
    """G6: the variance of first order is about (density at the ramp)/width, that of zeroth order does not grow."""
    for width in (1e-1, 1e-2):
        first = first_order_bundle(ramp(width), THETA, STD, 200000, rng)
        inside = norm.cdf((width / 2 - THETA[0]) / STD) - norm.cdf((-width / 2 - THETA[0]) / STD)
        assert first.variance[0] == pytest.approx(inside / width**2 * (1 - inside), rel=0.1)
        assert abs(first.mean[0] - inside / width) < 4 * first.standard_error
    few = first_order_bundle(ramp(1e-5), THETA, STD, 100, rng)
    assert few.mean[0] == 0  # far fewer samples than 1/width: looks certain, and is wrong
    wide, narrow = (zeroth_order_bundle(ramp(w), THETA, STD, 20000, rng).variance[0] for w in (1e-1, 1e-5))
    assert narrow == pytest.approx(wide, rel=0.1)


def test_quadratic_has_no_bias(rng: np.random.Generator) -> None:
    """f = x.Ax/2: all estimators agree with A x; the variance of first order is std^2 A A^T, costs as documented."""
    A = np.array([[2.0, 0.3], [0.3, 1.0]])
    quadratic = Function(lambda x: 0.5 * torch.einsum("bi,ij,bj->b", x, torch.from_numpy(A), x))
    x = np.array([0.4, -1.0])
    exact = pathwise(quadratic, x, 5)
    np.testing.assert_allclose(exact.mean, A @ x, rtol=1e-12)
    np.testing.assert_allclose(exact.variance, 0, atol=1e-25)
    assert (exact.steps, exact.derivative_steps) == (15, 15)
    differences = finite_differences(quadratic, x, 1e-3, 5)
    np.testing.assert_allclose(differences.mean, A @ x, rtol=1e-9)
    assert (differences.steps, differences.derivative_steps) == (60, 0)
    first = first_order_bundle(quadratic, x, STD, 20000, rng)
    np.testing.assert_allclose(first.variance, STD**2 * (A @ A).diagonal(), rtol=0.05)
    zeroth = zeroth_order_bundle(quadratic, x, STD, 20000, rng)
    for estimate in (first, zeroth):
        assert np.linalg.norm(estimate.mean - A @ x) < 4 * estimate.standard_error


def test_samples_that_are_not_finite_are_counted() -> None:
    function = Function(lambda x: x[:, 0] * torch.tensor([1.0, float("nan"), 3.0], dtype=torch.float64))
    estimate = pathwise(function, np.array([1.0]), 3)
    assert (estimate.samples, estimate.failed) == (2, 1)
    assert estimate.mean[0] == pytest.approx(2.0)
