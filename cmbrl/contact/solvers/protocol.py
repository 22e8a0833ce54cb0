"""What every contact solver looks like from outside: problem in, velocity and impulses out, nothing believed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem

Law = Literal["exact", "convex", "softened"]
DEFAULT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Solution:
    """v (nv,) [m/s] at the end of the step, impulse (n, 1 + nt) [N s], iterations where the solver tells, ``ok``: its
    own flag, which no score looks at."""

    v: Array
    impulse: Array
    iterations: int | None
    ok: bool

    @classmethod
    def of_impulse(cls, problem: ContactProblem, impulse: Array, iterations: int | None, ok: bool) -> Solution:
        """For solvers in contact space: v' follows from the impulses (n, 1 + nt)."""
        return cls(problem.velocity(impulse), impulse, iterations, ok)

    @classmethod
    def failed(cls, problem: ContactProblem) -> Solution:
        """What stands for a solver that gave up or raised: free motion, no impulses."""
        return cls(problem.v_free.copy(), np.zeros_like(problem.b), None, False)


Finish = Callable[[], Solution]
Run = Callable[[float], Finish]


class Solver(Protocol):
    """A solver of contact problems; ``law`` is what it solves: "exact" Signorini-Coulomb, its "convex" relaxation
    (no De Saxce shift) or a "softened" law.

    Work comes in three parts, so that a benchmark can time the middle one alone: ``prepare(problem)`` lays out the
    arrays that the solver's own interface takes and returns ``run``; ``run(tolerance)`` solves from scratch and returns
    ``finish``; ``finish()`` translates the answer back.
    """

    name: str
    law: Law

    def prepare(self, problem: ContactProblem) -> Run: ...

    def solve(self, problem: ContactProblem, tolerance: float = DEFAULT_TOLERANCE) -> Solution:
        """All three at once; ``tolerance`` is relative and means what the solver makes of it."""
        if not len(problem.mu):
            return Solution(problem.v_free.copy(), np.zeros_like(problem.b), 0, True)
        return self.prepare(problem)(tolerance)()
