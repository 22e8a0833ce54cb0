"""What an answer is worth: on the exact law, and on the convex relaxation for solvers that aim at that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.contact.certificates import project, residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers import Solution


@dataclass(frozen=True)
class Score:
    """``natural_map``, ``dynamics`` and ``penetration`` are those of ``cmbrl.contact.certificates``, of the exact law.

    ``relaxed``: natural map of the convex relaxation, K_mu contains lambda, perpendicular to c, in the dual cone;
    ``power``: |<lambda, c>|, what that relaxation makes zero for cones and pyramids alike. Both in the same units.
    """

    natural_map: float
    dynamics: float
    penetration: float
    relaxed: float
    power: float

    @property
    def convex(self) -> float:
        """What a solver of the relaxation must make zero whatever its cone: power, dynamics, penetration."""
        return max(self.power, self.dynamics, self.penetration)

    @property
    def laws(self) -> float:
        """Natural map and momentum balance."""
        return max(self.natural_map, self.dynamics)

    @property
    def exact(self) -> float:
        """The largest of the first three. The natural map alone forgives a light body under a heavy one its speed and
        anyone who returns v' without the impulses that make it."""
        return max(self.natural_map, self.dynamics, self.penetration)


def score(problem: ContactProblem, solution: Solution) -> Score:
    """Everything is infinite for an answer that is not finite."""
    if not (np.isfinite(solution.v).all() and np.isfinite(solution.impulse).all()):
        return Score(*[float("inf")] * 5)
    exact = residuals(problem, solution.v, solution.impulse)
    c = problem.J @ solution.v + problem.b + problem.R * solution.impulse
    force = max(float(np.linalg.norm(problem.M @ problem.v_free)), 1e-300) / len(problem.mu)
    diagonal = np.diag(problem.delassus()).reshape(c.shape) + problem.R
    step = 1 / np.maximum(diagonal.max(axis=1, keepdims=True), 1e-300)
    moved = solution.impulse - project(solution.impulse - step * c, problem.mu)
    return Score(
        exact.natural_map, exact.dynamics, exact.penetration, float(np.linalg.norm(moved)) / force,
        abs(float((solution.impulse * c).sum())) / (force * problem.speed),
    )  # fmt: skip
