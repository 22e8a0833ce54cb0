"""Clarabel through its own interface: an interior-point method for cone programs (Goulart and Chen 2024).

It takes second-order friction cones, so it needs no pyramid in space.
"""

from __future__ import annotations

from collections.abc import Callable

import clarabel
import numpy as np
import scipy.sparse

from cmbrl.contact.problem import Array
from cmbrl.contact.solvers.fixed_point import Answer, Resolve
from cmbrl.contact.solvers.formulation import Program


def lay_out(program: Program) -> Callable[[float], Resolve]:
    """Sets a solver up once; new right-hand sides update it."""
    P, A = scipy.sparse.csc_matrix(np.triu(program.H)), scipy.sparse.csc_matrix(-program.C)
    cones = [clarabel.SecondOrderConeT(program.J.shape[1])] * len(program.b)

    def set_up(tolerance: float) -> Resolve:
        settings = clarabel.DefaultSettings()
        settings.verbose = settings.presolve_enable = False
        settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = tolerance
        solver = None

        def resolve(lower: Array) -> Answer:
            nonlocal solver
            if solver is None:
                solver = clarabel.DefaultSolver(P, program.f, A, -lower, cones, settings)
            else:
                solver.update(b=-lower)
            solved = solver.solve()
            return Answer(
                np.array(solved.x), np.array(solved.z), solved.iterations, solved.status == clarabel.SolverStatus.Solved
            )

        return resolve

    return set_up
