"""The objective of a search: the prediction loss plus a Gaussian prior, over the parameters that may move.

    J(z) = L(theta(z)) + s |z|^2 / 2,   s = ALIKE tau^2 / n

This is the negative log posterior times ALIKE tau^2 / n if residuals have variance tau^2 on n transitions and the
likelihood is tempered by 1 / ALIKE: residuals are mostly model error, hence similar in neighbouring transitions, so ten
of them count as one. A parameter that the data do not inform stays at its nominal value, and a well-informed one hardly
feels the prior. ALIKE = 10 is our choice: with 1, a single hard impact of the half-cheetah bends the softness of the
geom involved; with 1000, well-informed parameters of the hopper are held back (held-out loss up 15 %).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbrl.fitting.loss import NormalEquations, PredictionLoss
from cmbrl.fitting.space import Space

ALIKE = 10.0
_VARIANCE_RANGE = (1e-6, 1.0)  # of a normalised residual: from the solver's accuracy to no model at all


@dataclass(frozen=True)
class Objective:
    """``active`` (n,) bool: parameters that may move; ``strength``: s of the prior."""

    loss: PredictionLoss
    space: Space
    active: np.ndarray
    strength: float

    @classmethod
    def at(cls, loss: PredictionLoss, space: Space, active: np.ndarray, z: np.ndarray) -> Objective:
        """The objective with the residual variance, and the starts of windows, taken at ``z`` (n,)."""
        loss = loss.settled(space.theta(z))
        value = float(loss.values(space.theta(z)[None])[0])
        variance = float(
            np.clip(value / len(loss.windows.scales.v), *_VARIANCE_RANGE)
        )  # L sums r^2 / 2 over 2 nv coordinates
        return cls(loss, space, active, ALIKE * variance / loss.steps)

    def values(self, z: np.ndarray) -> np.ndarray:
        """J (C,) of candidates (C, n); infinite where the loss is NaN."""
        total = self.loss.values(self.space.theta(z)) + 0.5 * self.strength * (z**2).sum(axis=1)
        return np.where(np.isnan(total), np.inf, total)

    def followed(self, equations: NormalEquations, step: np.ndarray) -> Objective:
        """The objective with the starts of windows moved along with a ``step`` (n,) from where ``equations`` are."""
        offset = self.loss.windows.offset
        if equations.follow is None or offset is None:
            return self
        return replace(self, loss=self.loss.starting(equations.follow.at(offset, step)))

    def normal_equations(self, z: np.ndarray) -> NormalEquations:
        """Gradient and Gauss-Newton Hessian of J at ``z`` (n,), over the active parameters."""
        equations = self.loss.normal_equations(self.space, z, self.active)
        return replace(
            equations,
            gradient=equations.gradient + self.strength * z,
            hessian=equations.hessian + self.strength * np.eye(len(z)),
        )

    def clip(self, z: np.ndarray) -> np.ndarray:
        """``z`` moved inside the bounds."""
        return np.clip(z, self.space.z_low, self.space.z_high)
