"""Alpha-order gradient (AoBG): first and zeroth order, weighted by variance within a bound on the bias.

Suh, Simchowitz, Zhang & Tedrake, "Do Differentiable Simulators Give Better Policy Gradients?" (ICML 2022), section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.errors import UserError
from cmbrl.gradients.estimate import Estimate


@dataclass(frozen=True)
class BiasBound:
    """How biased the mixture may be. The default, infinite gamma, is pure inverse variance: no bound.

    Args:
        gamma: largest bias allowed, in units of the gradient.
        delta: probability with which the bound may fail.
        scale: L, bound on a zeroth-order sample in the concentration inequality, in units of the gradient.
    """

    gamma: float = np.inf
    delta: float = 0.05
    scale: float = 1.0

    def uncertainty(self, zeroth: Estimate) -> float:
        """epsilon: bound on the error of the mean of the zeroth-order samples (vector Bernstein inequality)."""
        samples, log = zeroth.samples, np.log((zeroth.gradients.shape[1] + 1) / self.delta)
        return float(np.sqrt(2 * zeroth.total_variance * log / samples) + 2 * self.scale * log / (3 * samples))


def weight(v1: float, v0: float, distance: float, gamma: float = np.inf, epsilon: float = 0.0) -> float:
    """a in [0, 1] that minimises a^2 v1 + (1 - a)^2 v0 subject to epsilon + a distance <= gamma.

    v1, v0: variances of the first- and zeroth-order means; ``distance`` between the two means. The result is 0 if even
    a = 0 may break the bound (epsilon > gamma), and 1/2 if both variances vanish and the bound does not decide.
    """
    if epsilon > gamma:
        return 0.0
    free = v0 / (v1 + v0) if v1 + v0 > 0 else 0.5
    return free if np.isinf(gamma) or free * distance <= gamma - epsilon else (gamma - epsilon) / distance


def aobg(first: Estimate, zeroth: Estimate, bound: BiasBound | None = None) -> tuple[Estimate, float]:
    """a g1 + (1 - a) g0 and a, from equally many INDEPENDENT samples, each with its own noise and initial states.

    Raises UserError for unequal numbers of samples. A pair of samples is one sample of the mixture, so that variances
    and costs add up; a pair in which one is not finite is left out.
    """
    if first.gradients.shape != zeroth.gradients.shape:
        raise UserError(f"{first.gradients.shape} and {zeroth.gradients.shape} gradients: give equally many of each")
    bound = bound or BiasBound()
    distance = float(np.linalg.norm(first.mean - zeroth.mean))
    v1, v0 = (e.total_variance / max(e.samples, 1) for e in (first, zeroth))
    a = weight(v1, v0, distance, bound.gamma, bound.uncertainty(zeroth)) if np.isfinite(v1 + v0 + distance) else 0.0
    mixed = a * first.gradients + (1 - a) * zeroth.gradients if a else zeroth.gradients
    return Estimate(mixed, first.steps + zeroth.steps, first.derivative_steps + zeroth.derivative_steps), a
