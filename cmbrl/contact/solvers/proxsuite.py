"""ProxQP through its own dense interface: an augmented Lagrangian method (Bambade, El-Kazdadi, Taylor and others 2022).

The duality gap is checked too; without it, complementarity stays at 1e-1 to 1e-4 for any tolerance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from proxsuite import proxqp

from cmbrl.contact.problem import Array
from cmbrl.contact.solvers.fixed_point import Answer, Resolve
from cmbrl.contact.solvers.formulation import Program


def lay_out(program: Program) -> Callable[[float], Resolve]:
    """Sets a solver up once; new right-hand sides start from the last answer."""

    def set_up(tolerance: float) -> Resolve:
        qp = proxqp.dense.QP(len(program.f), 0, len(program.C))
        settings = qp.settings
        settings.eps_abs, settings.eps_rel, settings.check_duality_gap = tolerance, 0.0, True
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = tolerance, 0.0
        settings.max_iter = 1000
        qp.init(program.H, program.f, None, None, program.C, program.offset, np.full(len(program.C), 1e20))
        first = True

        def resolve(lower: Array) -> Answer:
            nonlocal first
            if not first:
                settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
                qp.update(l=lower)
            first = False
            qp.solve()
            info = qp.results.info
            solved = info.status == proxqp.QPSolverOutput.PROXQP_SOLVED
            return Answer(qp.results.x.copy(), np.maximum(-qp.results.z, 0.0), int(info.iter), solved)

        return resolve

    return set_up
