"""DAQP through its own interface: a dual active-set method for small dense QPs (Arnstrom, Bemporad and Axehill 2022).

The tolerance is the allowed constraint violation; answers have round-off accuracy anyway.
"""

from __future__ import annotations

from collections.abc import Callable

import daqp
import numpy as np

from cmbrl.contact.problem import Array
from cmbrl.contact.solvers.fixed_point import Answer, Resolve
from cmbrl.contact.solvers.formulation import Program


def lay_out(program: Program) -> Callable[[float], Resolve]:
    """Sets a solver up for every right-hand side, because DAQP's Python interface cannot update one."""
    H, f, C = (np.ascontiguousarray(x) for x in (program.H, program.f, program.C))
    upper, sense = np.full(len(C), 1e30), np.zeros(len(C), dtype=np.int32)

    def set_up(tolerance: float) -> Resolve:
        primal = min(max(tolerance, 1e-14), 1e-6)

        def resolve(lower: Array) -> Answer:
            x, _, flag, info = daqp.solve(H, f, C, upper, lower, sense, primal_tol=primal)
            return Answer(x, -info["lam"], info["iterations"], flag == 1)

        return resolve

    return set_up
