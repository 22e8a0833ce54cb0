"""The objective of a search: the prediction loss plus a Gaussian prior, over the parameters that may move.

    J(z) = L(theta(z)) + s z^T K z / 2,   s = tau^2 / m

K is the precision of the prior (``space``). This is the negative log posterior times tau^2 / m if residuals have
variance tau^2 and the log is worth m independent observations (``PredictionLoss.independent``). Residuals are mostly
model error, hence similar in neighbouring transitions: as many as are correlated count as one, or ALIKE where windows
are too short to tell. A parameter that the data do not inform stays at its nominal value, and a well-informed one
hardly feels the prior. ALIKE = 10 is our choice: with 1, a single hard impact of the half-cheetah bends the softness of
the geom involved; with 1000, well-informed parameters of the hopper are held back (held-out loss up 15 %).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbrl.errors import UserError
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.search.space import Space


class NotFinite(UserError):
    """Numbers that overflow, from a log or from parameters that no robot has."""


NOT_FINITE = (
    "the fit is not finite: check the log for values that no robot reaches, and whether the file is stable in its step"
)
SOLVER_VARIANCE = 1e-8  #: of a normalised residual that the solver's accuracy leaves
_VARIANCE_RANGE = (SOLVER_VARIANCE, 1.0)  # to no model at all


@dataclass(frozen=True)
class Objective:
    """``active`` (n,) bool: parameters that may move; ``strength``: s of the prior, from the ``variance`` tau^2.

    ``remaining``: the loss where it was taken.
    """

    loss: PredictionLoss
    space: Space
    active: np.ndarray
    strength: float
    variance: float = 0.0
    remaining: float = np.inf

    @classmethod
    def at(cls, loss: PredictionLoss, space: Space, active: np.ndarray, z: np.ndarray, least: float = 0.0) -> Objective:
        """The objective with the residual variance, and the starts of windows, taken at ``z`` (n,).

        ``least``: the variance that weighs the prior at least.
        """
        loss = loss.settled(space.theta(z))
        errors = loss.errors_from_here(space.theta(z))
        told = errors.loss[np.isfinite(errors.loss)]  # a window that diverges says nothing of what the others leave
        remaining = float(told.mean()) if len(told) else np.inf
        variance = 2.0 * remaining / loss.windows.scales.observed  # L sums r^2 / 2 over the coordinates
        variance = max(float(np.clip(variance, *_VARIANCE_RANGE)), least)
        return cls(loss, space, active, variance / loss.independent(errors.alike), variance, remaining)

    def values(self, z: np.ndarray, offset: np.ndarray | None = None, most: float = np.inf) -> np.ndarray:
        """J (C,) of candidates (C, n), from an ``offset`` (C, S, k) of each one's own if given; infinite for a NaN.

        What is beyond ``most`` is infinite.
        """
        prior = 0.5 * self.strength * ((z @ self.space.precision) * z).sum(axis=1)
        total = self.loss.values(self.space.theta(z), offset, prior, most)
        return np.where(np.isnan(total), np.inf, total)

    def followed(self, equations: NormalEquations, steps: np.ndarray) -> np.ndarray | None:
        """The starts of windows (C, S, k) that follow ``steps`` (C, n) from where ``equations`` are, if they move."""
        offset = self.loss.windows.offset
        return None if equations.follow is None or offset is None else equations.follow.at(offset, steps)

    def starting(self, offset: np.ndarray) -> Objective:
        """The objective with the windows starting at ``offset`` (S, k)."""
        return replace(self, loss=self.loss.starting(offset))

    def begun(self, z: np.ndarray) -> Objective:
        """The objective with episodes beginning as they do at ``z`` (n,); the same object where that is told."""
        loss = self.loss.begun(self.space.theta(z))
        return self if loss is self.loss else replace(self, loss=loss)

    def normal_equations(self, z: np.ndarray) -> NormalEquations:
        """Gradient and Gauss-Newton Hessian of J at ``z`` (n,), over the active parameters."""
        equations = self.loss.normal_equations(self.space, z, self.active)
        return replace(
            equations,
            gradient=equations.gradient + self.strength * (self.space.precision @ z),
            hessian=equations.hessian + self.strength * self.space.precision,
        )

    def clip(self, z: np.ndarray) -> np.ndarray:
        """``z`` moved inside the bounds."""
        return np.clip(z, self.space.z_low, self.space.z_high)
