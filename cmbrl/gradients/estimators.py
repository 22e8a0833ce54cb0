"""Estimators of the gradient of an expected value: first order (pathwise), zeroth order, and bundles of either.

Suh, Simchowitz, Zhang & Tedrake, "Do Differentiable Simulators Give Better Policy Gradients?" (ICML 2022), section 2.

The bundles and ``pathwise`` take one point x (n,) for all samples, or one point per sample (samples, n).
"""

from __future__ import annotations

import numpy as np
import torch

from cmbrl.gradients.estimate import Array, Estimate, Objective


def pathwise(objective: Objective, x: Array, samples: int) -> Estimate:
    """First order: mean over samples of the derivative at x."""
    return _first_order(objective, np.broadcast_to(x, (samples, x.shape[-1])))


def first_order_bundle(objective: Objective, x: Array, std: float, samples: int, rng: np.random.Generator) -> Estimate:
    """d/dx E f(x + w), w normal with standard deviation ``std``, as the mean of f'(x + w).

    Unbiased only where f is continuous: jumps of f contribute nothing, and most batches miss ramps narrower than
    std / samples ("empirical bias").
    """
    return _first_order(objective, x + std * rng.normal(size=(samples, x.shape[-1])))


def zeroth_order_bundle(objective: Objective, x: Array, std: float, samples: int, rng: np.random.Generator) -> Estimate:
    """d/dx E f(x + w) as the mean of w (f(x + w) - f(x - w)) / (2 std^2): values only, unbiased even for jumps.

    Antithetic pairs replace the baseline f(x): both take two values per sample, and here even terms of f cancel.
    """
    w = std * rng.normal(size=(samples, x.shape[-1]))
    with torch.no_grad():
        up, down = (objective(torch.from_numpy(x + sign * w)).numpy() for sign in (1, -1))
    return Estimate(w * ((up - down) / (2 * std**2))[:, None], 2 * samples * objective.steps)


def finite_differences(objective: Objective, x: Array, step: float, samples: int) -> Estimate:
    """Reference: central differences of every sample along every coordinate, with the same randomness on both sides.

    The mean is the gradient of the expected value averaged over x +- step in each coordinate; its standard error is due
    to the number of ``samples``.
    """
    gradients = np.empty((samples, len(x)))
    with torch.no_grad():
        for k, unit in enumerate(np.eye(len(x))):
            up, down = (objective(torch.from_numpy(np.tile(x + s * unit, (samples, 1)))) for s in (step, -step))
            gradients[:, k] = (up - down).numpy() / (2 * step)
    return Estimate(gradients, 2 * len(x) * samples * objective.steps)


def _first_order(objective: Objective, points: Array) -> Estimate:
    """Each row of the batch depends on its own row of x only, so that one backward pass gives all gradients."""
    x = torch.tensor(points, requires_grad=True)
    value = objective(x).sum()
    gradients = torch.zeros_like(x)
    if value.requires_grad:  # a piecewise constant function may have no graph at all
        (found,) = torch.autograd.grad(value, x, allow_unused=True)
        gradients = gradients if found is None else found
    steps = len(points) * objective.steps
    return Estimate(gradients.numpy(), steps, steps)
