"""Our own interior point on contact problems given by their arrays, many of one shape at a time.

The exact law: along the central path until every contact knows whether it is open, sticks or slides, then Newton on the
law itself (projections of Alart and Curnier, CMAME 1991). The softened law: every complementarity product equals kappa.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cmbrl.contact.problem import FIELDS, Array, ContactProblem
from cmbrl.contact.solvers.protocol import Finish, Law, Run, Solution, Solver
from cmbrl.errors import UserError
from cmbrl.native import Problems

DEFAULT_TOLERANCE = 1e-11


@dataclass(frozen=True)
class Batch:
    """Problems of one shape below each other: M (B, nv, nv), J (B, n, 1 + nt, nv), v_free (B, nv), b, R (B, n, 1 + nt),
    mu (B, n). The tangents of a contact share one compliance: the first tangent's."""

    M: Array
    J: Array
    v_free: Array
    b: Array
    mu: Array
    R: Array

    @classmethod
    def of(cls, problems: Sequence[ContactProblem]) -> Batch:
        """Raises UserError for no problems, or for different numbers of dofs, contacts or tangents."""
        if len({p.J.shape for p in problems}) != 1:
            raise UserError("a batch takes problems of one shape, at least one: group them by J.shape")
        arrays = {field: np.array([getattr(p, field) for p in problems]) for field in FIELDS}
        return cls(**{field: np.ascontiguousarray(x, dtype=np.float64) for field, x in arrays.items()})

    def native(self, derivative: bool = False) -> Problems:
        """Handle of the core on these arrays: ``solve(tolerance, kappa, threads)`` writes the arrays in ``results``."""
        return Problems(self.M, self.J, self.v_free, self.b, self.mu, self.R, derivative)


@dataclass(frozen=True)
class Solutions:
    """v (B, nv), impulse (B, n, 1 + nt) [N s]; status (B,) 0 solved, 1 solved with compliance added (softened law),
    2 failed; residual (B,): of the exact law the natural map relative to |M v_free| / n, of the softened the largest
    relative linear residual; derivative dv'/dv_free (B, nv, nv) by the implicit function theorem where asked for."""

    v: Array
    impulse: Array
    status: NDArray[np.int32]
    iterations: NDArray[np.int32]
    residual: Array
    derivative: Array | None = None


def solve(
    problems: Batch | Sequence[ContactProblem],
    kappa: float | Array | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    derivative: bool = False,
    threads: int = 1,
) -> Solutions:
    """Solves problems of one shape.

    Args:
        problems: a :class:`Batch`, or problems to make one of.
        kappa: None for the exact law; else the softened law at this central-path parameter [J], one or (B,).
        tolerance: exact law: natural map, relative to |M v_free| / n.
        derivative: also dv'/dv_free (of the exact law: of the piece of it that the solution lies on).
        threads: native threads; results do not depend on it.

    Raises: UserError where problems do not make a batch or kappa is not positive.
    """
    batch = problems if isinstance(problems, Batch) else Batch.of(problems)
    if kappa is not None:
        kappa = np.broadcast_to(np.asarray(kappa, dtype=np.float64), len(batch.v_free)).copy()
        if not (kappa > 0).all():
            raise UserError("kappa must be positive; leave it out for the exact law")
    native = batch.native(derivative)
    native.solve(tolerance, kappa, threads)
    return Solutions(**native.results)


@dataclass(frozen=True)
class InteriorPoint(Solver):
    """One problem at a time. ``law`` "exact", or "softened": the tolerance is then kappa itself in units of the largest
    energy c^2 / G of a row."""

    name: str = "ours"
    law: Law = "exact"

    def prepare(self, problem: ContactProblem) -> Run:
        native = Batch.of([problem]).native()
        energy = np.array([_energy(problem)])

        def run(tolerance: float) -> Finish:
            native.solve(tolerance, None if self.law == "exact" else tolerance * energy)
            return lambda: _solution(native.results)

        return run


def _solution(results: dict[str, Array]) -> Solution:
    v, impulse = results["v"][0].copy(), results["impulse"][0].copy()
    return Solution(v, impulse, int(results["iterations"][0]), bool(results["status"][0] == 0))


def _energy(problem: ContactProblem) -> float:
    inertia = np.diag(problem.delassus()).reshape(problem.b.shape) + problem.R
    speed = problem.free_contact_velocity()
    return float((speed**2 / np.where(inertia > 0, inertia, np.inf)).max(initial=0.0)) or 1.0
