"""QP solvers through the common interface of ``qpsolvers``, which sets the solver up at every call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import qpsolvers
import scipy.sparse

from cmbrl.contact.problem import Array
from cmbrl.contact.solvers.fixed_point import Answer, Resolve
from cmbrl.contact.solvers.formulation import Program

SPARSE = ("clarabel", "highs", "osqp", "scs")  #: these take compressed columns and warn about anything else
#: settings for a tolerance; defaults of the first-order methods are 1e-3 to 1e-5
TOLERANCE: dict[str, Callable[[float], dict[str, Any]]] = {
    "clarabel": lambda e: {"tol_feas": e, "tol_gap_abs": e, "tol_gap_rel": e},
    "daqp": lambda e: {"primal_tol": min(e, 1e-6)},
    "highs": lambda e: {"primal_feasibility_tolerance": max(e, 1e-10), "dual_feasibility_tolerance": max(e, 1e-10)},
    "osqp": lambda e: {"eps_abs": e, "eps_rel": 0.0, "max_iter": 20_000, "polishing": True},
    "piqp": lambda e: {"eps_abs": e, "eps_rel": 0.0, "eps_duality_gap_abs": e, "eps_duality_gap_rel": 0.0},
    "proxqp": lambda e: {"eps_abs": e, "eps_rel": 0.0, "check_duality_gap": True, "eps_duality_gap_abs": e,
                         "eps_duality_gap_rel": 0.0},
    "quadprog": lambda e: {},
    "scs": lambda e: {"eps_abs": e, "eps_rel": 0.0, "max_iters": 20_000},
}  # fmt: skip


def lay_out(program: Program, solver: str) -> Callable[[float], Resolve]:
    """Sets up the solver that ``qpsolvers`` knows by this name."""
    P, G = program.H, -program.C
    if solver in SPARSE:
        P, G = scipy.sparse.csc_matrix(P), scipy.sparse.csc_matrix(G)

    def set_up(tolerance: float) -> Resolve:
        options = TOLERANCE[solver](tolerance)

        def resolve(lower: Array) -> Answer:
            problem = qpsolvers.Problem(P, program.f, G, -lower)
            try:
                solved = qpsolvers.solve_problem(problem, solver=solver, **options)
            except (qpsolvers.SolverError, ValueError):  # quadprog raises ValueError for some inputs
                return Answer(np.full(len(program.f), np.nan), np.full(len(program.C), np.nan), None, False)
            if solved.x is None or solved.z is None:
                return Answer(np.full(len(program.f), np.nan), np.full(len(program.C), np.nan), None, False)
            return Answer(solved.x, np.maximum(solved.z, 0.0), None, bool(solved.found))

        return resolve

    return set_up
