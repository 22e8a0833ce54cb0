"""Two laws from a solver of convex programs: the relaxation in one solve, the exact law by iteration.

The exact law follows from the De Saxce fixed point (Acary, Cadoux, Lemarechal and Malick 2011): solve with the shift
mu s, set s to the slip of the answer, and repeat until it no longer changes. One sliding mass contracts by
mu^2 / (1 + mu^2) per solve; with large friction the iteration may not contract at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers.formulation import Program
from cmbrl.contact.solvers.protocol import Finish, Law, Run, Solution, Solver


@dataclass(frozen=True)
class Answer:
    """x (n,), multipliers (m,) of the rows, iterations if known, and the solver's own flag."""

    x: Array
    multipliers: Array
    iterations: int | None
    ok: bool


Resolve = Callable[[Array], Answer]  #: lower (m,) -> answer
Formulate = Callable[[ContactProblem], Program]
LayOut = Callable[[Program], Callable[[float], Resolve]]


@dataclass(frozen=True)
class Relaxed(Solver):
    """The convex relaxation: one solve with s = 0. ``lay_out`` sets the program solver up."""

    name: str
    formulate: Formulate
    lay_out: LayOut
    law: Law = "convex"

    def prepare(self, problem: ContactProblem) -> Run:
        program = self.formulate(problem)
        set_up, lower = self.lay_out(program), program.offset

        def run(tolerance: float) -> Finish:
            return partial(_translate, program, set_up(tolerance)(lower))

        return run


@dataclass(frozen=True)
class DeSaxce(Solver):
    """The exact law, for the cone (in the plane and for second-order cones) or for the pyramid."""

    name: str
    formulate: Formulate
    lay_out: LayOut
    law: Law = "exact"
    passes: int = 200

    def prepare(self, problem: ContactProblem) -> Run:
        program = self.formulate(problem)
        set_up = self.lay_out(program)

        def run(tolerance: float) -> Finish:
            resolve, slip, used = set_up(tolerance), np.zeros(len(problem.mu)), 0
            for _ in range(self.passes):
                answer = resolve(program.lower(slip))
                used += answer.iterations or 1
                last, slip = slip, program.slip(answer.x)
                change = np.abs(slip - last).max()
                if not change > tolerance:  # also ends on NaN
                    break
            ok = answer.ok and bool(change <= tolerance)
            return partial(_translate, program, Answer(answer.x, answer.multipliers, used, ok))

        return run


def _translate(program: Program, answer: Answer) -> Solution:
    if not (np.isfinite(answer.x).all() and np.isfinite(answer.multipliers).all()):
        return Solution.failed(program.problem)
    return Solution(program.velocity(answer.x), program.impulse(answer.multipliers), answer.iterations, answer.ok)
