"""Our interior-point method on batches of contact problems of one shape.

The law itself (exact, or convex in sliding): follow the central path until every contact is known to be open, sticking
or sliding, then apply Newton's method to the law (projections of Alart and Curnier, CMAME 1991). The softened law:
every complementarity product equals kappa.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cmbrl.contact.problem import FIELDS, Array, ContactProblem
from cmbrl.contact.solvers.protocol import Finish, Law, Run, Solution, Solver
from cmbrl.errors import UserError
from cmbrl.native import Problems, SolverStatus

DEFAULT_TOLERANCE = 1e-11
_EVEN = 1e-9  # relative difference of two compliances that are meant to be equal


@dataclass(frozen=True)
class Batch:
    """Stacked problems of one shape: M (B, nv, nv), J (B, n, 1 + nt, nv), v_free (B, nv), b, R (B, n, 1 + nt),
    mu (B, n); convex (B, n), 1 where a contact has the convex law of sliding (default: nowhere).

    Raises UserError if the tangents of a contact with friction differ in compliance: the cone is round.
    """

    M: Array
    J: Array
    v_free: Array
    b: Array
    mu: Array
    R: Array
    convex: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.convex is None:
            object.__setattr__(self, "convex", np.zeros_like(self.mu))
        uneven = (self.mu > 0) & (np.ptp(self.R[..., 1:], axis=-1) > _EVEN * self.R[..., 1:].max(axis=-1))
        if uneven.any():
            problem, contact = np.argwhere(uneven)[0]
            values = " and ".join(f"{x:.6g}" for x in self.R[problem, contact, 1:])
            raise UserError(
                f"problem {problem}, contact {contact}: its tangents have compliances R of {values}; make them equal"
            )

    @classmethod
    def of(cls, problems: Sequence[ContactProblem]) -> Batch:
        """Stacks problems; raises UserError for none, or for different numbers of dofs, contacts or tangents."""
        if len({p.J.shape for p in problems}) != 1:
            raise UserError("a batch takes at least one problem, all of one shape; group them by J.shape")
        arrays = {field: np.array([getattr(p, field) for p in problems]) for field in FIELDS}
        return cls(**{field: np.ascontiguousarray(x, dtype=np.float64) for field, x in arrays.items()})

    def native(self, derivative: bool = False) -> Problems:
        """The core's handle on these arrays; ``solve(tolerance, kappa, threads)`` fills its ``results``."""
        convex = self.convex if self.convex.any() else None
        return Problems(self.M, self.J, self.v_free, self.b, self.mu, self.R, derivative, convex)


@dataclass(frozen=True)
class Solutions:
    """v (B, nv); impulse (B, n, 1 + nt) [N s]; status (B,), a :class:`~cmbrl.native.SolverStatus`; residual (B,): for
    the exact law the natural map relative to |M v_free| / n, for the softened law the largest relative linear residual;
    derivative dv'/dv_free (B, nv, nv) by the implicit function theorem, on request."""

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
        problems: a :class:`Batch`, or problems to stack.
        kappa: None for the exact law, or the central-path parameter [J] of the softened law, a number or (B,).
        tolerance: exact law: natural map, relative to |M v_free| / n.
        derivative: also return dv'/dv_free (under the exact law, of the smooth piece at the solution).
        threads: native threads; results do not depend on it.

    Raises: UserError if the problems cannot be stacked, or kappa is not positive.
    """
    batch = problems if isinstance(problems, Batch) else Batch.of(problems)
    if kappa is not None:
        kappa = np.broadcast_to(np.asarray(kappa, dtype=np.float64), len(batch.v_free)).copy()
        if not (kappa > 0).all():
            raise UserError("kappa must be positive; drop it for the exact law")
    native = batch.native(derivative)
    native.solve(tolerance, kappa, threads)
    return Solutions(**native.results)


@dataclass(frozen=True)
class InteriorPoint(Solver):
    """One problem at a time. For ``law`` "softened", the tolerance is kappa in units of the largest energy c^2 / G of a
    row."""

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
    return Solution(v, impulse, int(results["iterations"][0]), bool(results["status"][0] == SolverStatus.CONVERGED))


def _energy(problem: ContactProblem) -> float:
    inertia = np.diag(problem.delassus()).reshape(problem.b.shape) + problem.R
    speed = problem.free_contact_velocity()
    return float((speed**2 / np.where(inertia > 0, inertia, np.inf)).max(initial=0.0)) or 1.0
