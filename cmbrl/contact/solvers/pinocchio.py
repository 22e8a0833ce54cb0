"""Pinocchio's contact solvers on the Delassus matrix (Carpentier, Le Lidec and Montaut 2024).

Its rows are (tangents, normal) with two tangents; planar contacts get an uncoupled second one. Units are those of our
ADMM. Compliance goes on the diagonal, because Pinocchio ignores its own scalar compliance. A solve without contacts
would end the process, so none gets here. Its Gauss-Seidel solver reports "converged" on stacks with half the force
missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers.contact_space import ContactSpace
from cmbrl.contact.solvers.formulation import sliding_only
from cmbrl.contact.solvers.protocol import Finish, Law, Run, Solution, Solver

ITERATIONS = 5000


@dataclass(frozen=True)
class Pinocchio(Solver):
    """``method``: "ADMM" or "PGS". ``law`` "convex" omits De Saxce's shift (ADMM only)."""

    name: str
    method: str
    law: Law = "exact"
    iterations: int = ITERATIONS

    def prepare(self, problem: ContactProblem) -> Run:
        sliding_only(problem, "Pinocchio's point contact")
        space = ContactSpace.of(problem)
        place = _places(len(problem.mu), space.rows)
        size = 3 * len(problem.mu)
        G, g = np.zeros((size, size)), np.zeros(size)
        G[np.ix_(place, place)], g[place] = space.G, space.g
        still = np.flatnonzero(np.diag(G) == 0)  # rows without mobility; its Gauss-Seidel divides by the diagonal
        G[still, still] = G[still // 3 * 3 + 2, still // 3 * 3 + 2]
        models, data = _constraints(problem.mu)
        make, make_settings, make_result = (
            getattr(pin, self.method + part) for part in ("ConstraintSolver", "SolverSettings", "SolverResult")
        )
        settings = make_settings()
        settings.max_iterations, settings.solve_ncp = self.iterations, self.law == "exact"

        def run(tolerance: float) -> Finish:
            for kind in ("feasibility", "complementarity"):
                setattr(settings, f"absolute_{kind}_tol", tolerance)
                setattr(settings, f"relative_{kind}_tol", 0.0)
            solver, result = make(), make_result()
            ok = solver.solve(pin.DelassusOperatorDense(G), g, models, data, settings, result)
            return partial(_finish, problem, space, place, result, ok)

        return run


def _finish(problem: ContactProblem, space: ContactSpace, place: np.ndarray, result: Any, ok: bool) -> Solution:
    x: Array = np.asarray(result.retrieveConstraintImpulses()).ravel()[place]
    if not np.isfinite(x).all():
        return Solution.failed(problem)
    return Solution.of_impulse(problem, space.impulse(x), int(result.iterations), bool(ok))


def _places(contacts: int, rows: int) -> np.ndarray:
    """Indices of our rows (normal, tangents) among Pinocchio's (tangent, tangent, normal)."""
    return (3 * np.arange(contacts)[:, None] + np.array([2, 0, 1])[:rows]).ravel()


def _constraints(mu: Array) -> tuple[Any, Any]:
    """Point contacts on a model of one body: the solvers read only the friction; everything else is in G."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    models, data = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
    for friction in mu:
        contact = pin.PointContactConstraintModel(model, joint, pin.SE3.Identity())
        contact.setFriction(float(friction))
        general = pin.ConstraintModel(contact)
        models.append(general)
        data.append(general.createData())
    return models, data
