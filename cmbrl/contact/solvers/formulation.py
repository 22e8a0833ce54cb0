"""Contact as a convex program over the velocity, in one form for all program solvers.

    min 1/2 (v - v_f)' M (v - v_f)   subject to   J v + b + mu s e_n  in the dual friction cone of every contact

s = 0 is the convex relaxation (Anitescu and Potra 1997); s = |c_t| of the answer is the exact law (De Saxce and Feng
1998; the fixed point is in fixed_point.py). The Hessian is definite, so v' is unique even with redundant contacts;
the multipliers are the impulses. Compliant rows get an extra velocity: with y = sqrt(R) lambda, c = J v + b +
sqrt(R) y and the cost grows by y'y/2.

Velocities are scaled by the problem's speed, masses by the largest, rows to norm one in contact space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.errors import UserError

GENERATORS = 8  #: edges of the friction pyramid in space; in the plane two edges are the exact cone


@dataclass(frozen=True)
class Program:
    """min 1/2 x'Hx + f'x over C x >= lower(s), by rows (a pyramid) or by blocks of rows (a second-order cone).

    ``W`` (m, 1 + nt) maps the velocity of the contact ``contact`` (m,) of a row to the row. ``J`` and ``b`` are the
    problem's in scaled units, with compliance. ``cone``: rows come in blocks (normal, tangents) per contact.
    """

    problem: ContactProblem
    H: Array
    f: Array
    C: Array
    offset: Array
    lift: Array
    W: Array
    contact: np.ndarray
    J: Array
    b: Array
    mass: float
    cone: bool

    def lower(self, slip: Array) -> Array:
        """Right-hand side (m,) for the De Saxce shift mu slip, slip (n,) in units of the problem's speed."""
        return self.offset - self.lift * slip[self.contact]

    def slip(self, x: Array) -> Array:
        """The s (n,) that gives the exact law of this cone at x: |c_t|, or its polyhedral norm."""
        tangent = (self.J @ x + self.b)[:, 1:]
        if self.cone:
            return np.linalg.norm(tangent, axis=1)
        along = -np.einsum("mt,mt->m", self.W[:, 1:], tangent[self.contact])
        size = np.linalg.norm(self.W[:, 1:], axis=1)
        out = np.zeros(len(self.b))
        np.maximum.at(out, self.contact, along / np.where(size > 0, size, np.inf))
        return out

    def velocity(self, x: Array) -> Array:
        """v' (nv,) [m/s]."""
        return x[: len(self.problem.v_free)] * self.problem.speed

    def impulse(self, multipliers: Array) -> Array:
        """lambda (n, 1 + nt) [N s] from multipliers (m,) >= 0 (or in the cone)."""
        out = np.zeros_like(self.problem.b)
        np.add.at(out, self.contact, self.W * multipliers[:, None])
        return out * (self.mass * self.problem.speed)


def pyramid(problem: ContactProblem, generators: int = GENERATORS) -> Program:
    """Friction pyramids with ``generators`` edges in space; the exact cone in the plane.

    Raises UserError for contacts with torsional and rolling friction, whose pyramids would have too many edges.
    """
    nt = problem.b.shape[1] - 1
    sliding_only(problem, "a pyramid")
    angles = 2 * np.pi * np.arange(generators) / generators
    edges = np.array([[1.0], [-1.0]]) if nt == 1 else np.column_stack([np.cos(angles), np.sin(angles)])
    rough = problem.mu > 0
    contact = np.repeat(np.arange(len(problem.mu)), np.where(rough, len(edges), 1))
    mu = problem.mu[contact]
    tangents = np.zeros((len(contact), nt))
    tangents[mu > 0] = np.tile(edges, (int(rough.sum()), 1)) * mu[mu > 0, None]
    size = np.sqrt(1 + mu**2)
    return _program(problem, np.column_stack([np.ones(len(contact)), tangents]) / size[:, None], contact, mu / size)


def second_order_cone(problem: ContactProblem) -> Program:
    """One block of rows (c_n + mu s, mu c_t) per contact."""
    n, rows = problem.b.shape
    size = np.sqrt(1 + problem.mu**2)
    W = np.zeros((n, rows, rows))
    W[:, 0, 0] = 1 / size
    W[:, range(1, rows), range(1, rows)] = (problem.mu / size)[:, None]
    lift = np.zeros((n, rows))
    lift[:, 0] = problem.mu / size
    contact = np.repeat(np.arange(n), rows)
    return _program(problem, W.reshape(-1, rows), contact, lift.ravel(), cone=True)


def sliding_only(problem: ContactProblem, what: str) -> None:
    """Raises UserError if a contact has more rows than those of sliding in space."""
    if problem.b.shape[1] > 3:
        raise UserError(
            f"{problem.name}: {what} bounds sliding friction alone, not torsional and rolling friction; take a solver "
            "of round cones, as 'ours', 'admm' or 'clarabel'"
        )


def _program(problem: ContactProblem, W: Array, contact: np.ndarray, lift: Array, cone: bool = False) -> Program:
    M, J, v_free = problem.M, problem.J, problem.v_free / problem.speed
    soft = np.flatnonzero(problem.R.ravel())
    mass = float(np.diag(M).max())
    H = np.zeros((len(M) + len(soft),) * 2)
    H[: len(M), : len(M)] = M / mass
    if len(soft):
        H[range(len(M), len(H)), range(len(M), len(H))] = 1.0
        own = np.zeros((problem.b.size, len(soft)))
        own[soft, range(len(soft))] = np.sqrt(problem.R.ravel()[soft] * mass)
        J = np.concatenate([J, own.reshape(*problem.b.shape, -1)], axis=2)
        v_free = np.concatenate([v_free, np.zeros(len(soft))])
    b = problem.b / problem.speed
    return Program(
        problem=problem, H=H, f=-H @ v_free, C=np.einsum("mr,mrv->mv", W, J[contact]),
        offset=-np.einsum("mr,mr->m", W, b[contact]), lift=lift, W=W, contact=contact, J=J, b=b, mass=mass, cone=cone,
    )  # fmt: skip
