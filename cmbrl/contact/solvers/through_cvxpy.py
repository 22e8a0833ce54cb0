"""The cone program in cvxpy: readable, at a few milliseconds per solve.

Cost and bounds are parameters and the problem is compiled in advance (disciplined parametrised programming), so only a
solve with new numbers is timed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np

from cmbrl.contact.problem import Array
from cmbrl.contact.solvers.fixed_point import Answer, Resolve
from cmbrl.contact.solvers.formulation import Program

TOLERANCE: dict[str, Callable[[float], dict[str, Any]]] = {
    "CLARABEL": lambda e: {"tol_feas": e, "tol_gap_abs": e, "tol_gap_rel": e},
    "SCS": lambda e: {"eps_abs": e, "eps_rel": 0.0, "max_iters": 20_000},
}


def lay_out(program: Program, solver: str) -> Callable[[float], Resolve]:
    """Compiles ``program`` for cvxpy's solver of this name."""
    root = np.linalg.cholesky(program.H).T
    x, f, lower = cp.Variable(len(program.f)), cp.Parameter(len(program.f)), cp.Parameter(len(program.C))
    rows = program.J.shape[1]
    cones: list[cp.Constraint] = []
    for k in range(0, len(program.C), rows):
        c = program.C[k : k + rows] @ x - lower[k : k + rows]
        cones.append(cp.SOC(c[0], c[1:]))
    problem = cp.Problem(cp.Minimize(cp.sum_squares(root @ x) / 2 + f @ x), cones)
    f.value, lower.value = program.f, program.offset
    problem.get_problem_data(solver)

    def set_up(tolerance: float) -> Resolve:
        options = TOLERANCE[solver](tolerance)

        def resolve(bound: Array) -> Answer:
            f.value, lower.value = program.f, bound
            try:
                problem.solve(solver, warm_start=False, **options)
            except cp.SolverError:
                return _gave_up(program)
            if x.value is None or cones[0].dual_value is None:
                return _gave_up(program)
            multipliers = np.concatenate([np.concatenate([np.ravel(part) for part in k.dual_value]) for k in cones])
            return Answer(x.value, multipliers, problem.solver_stats.num_iters, problem.status == cp.OPTIMAL)

        return resolve

    return set_up


def _gave_up(program: Program) -> Answer:
    return Answer(np.full(len(program.f), np.nan), np.full(len(program.C), np.nan), None, False)
