"""The interface of every contact solver: a problem in, velocity and impulses out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem

Law = Literal["exact", "convex", "softened"]
DEFAULT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Solution:
    """v (nv,) [m/s] at the end of the step; impulse (n, 1 + nt) [N s]; iterations, if known; ``ok``: the solver's own
    flag, which scores ignore."""

    v: Array
    impulse: Array
    iterations: int | None
    ok: bool

    @classmethod
    def of_impulse(cls, problem: ContactProblem, impulse: Array, iterations: int | None, ok: bool) -> Solution:
        """Solution of a solver in contact space: v' follows from the impulses (n, 1 + nt)."""
        return cls(problem.velocity(impulse), impulse, iterations, ok)

    @classmethod
    def failed(cls, problem: ContactProblem) -> Solution:
        """Stands for a solver that failed: free motion, no impulses."""
        return cls(problem.v_free.copy(), np.zeros_like(problem.b), None, False)


Finish = Callable[[], Solution]
Run = Callable[[float], Finish]


class Solver(ABC):
    """A solver of contact problems. ``law`` is what it solves: "exact" Signorini-Coulomb, its "convex" relaxation (no
    De Saxce shift) or a "softened" law. Only ours looks at the problem's ``convex``: which contacts slide by which law.

    Work comes in three parts, so that a benchmark can time the middle one alone: ``prepare(problem)`` converts the
    input and returns ``run``; ``run(tolerance)`` solves from scratch and returns ``finish``; ``finish()`` converts the
    answer.
    """

    name: str
    law: Law

    @abstractmethod
    def prepare(self, problem: ContactProblem) -> Run:
        """Converts a problem with at least one contact to the solver's own input."""

    def solve(self, problem: ContactProblem, tolerance: float = DEFAULT_TOLERANCE) -> Solution:
        """All three parts; ``tolerance`` is relative, and its meaning is the solver's."""
        if not len(problem.mu):
            return Solution(problem.v_free.copy(), np.zeros_like(problem.b), 0, True)
        return self.prepare(problem)(tolerance)()
