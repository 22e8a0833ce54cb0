"""Exact derivatives of a contact step, given which contacts of a converged answer stick, slide or separate.

Within such a combination the laws are smooth equations, so dv'/dv_free is one linear solve, without kappa or steps.
With t = c_t/|c_t|, a sticking contact has dc = 0; a sliding one dc_n = 0 (exact law) or dc_n = mu t'dc_t (convex
relaxation) and d(lambda_t + mu lambda_n t) = 0; a separated one has no impulse. A friction pyramid uses active rows.
"""

from __future__ import annotations

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers import Solution
from cmbrl.contact.solvers.formulation import Program

CLEAR = 1e-6  #: relative distance from a change of mode below which no derivative is given


class Unclear(ValueError):
    """The answer is too close to a change of mode, or its contacts are redundant: no unique derivative exists."""


def cone_derivative(problem: ContactProblem, solution: Solution, relaxed: bool = False) -> Array:
    """dv'/dv_free (nv, nv) of the exact law, or of the convex relaxation, both with round cones.

    Raises Unclear where a contact is about to change its mode or the equations are singular.
    """
    nv, m = len(problem.v_free), problem.b.size
    rows, contact = problem.rows, np.arange(m).reshape(problem.b.shape)
    A = np.zeros((nv + m, nv + m))
    A[:nv, :nv], A[:nv, nv:] = problem.M, -rows.T
    dc = np.hstack([rows, np.diag(problem.R.ravel())])
    dx = np.hstack([np.zeros((m, nv)), np.eye(m)])
    c = problem.J @ solution.v + problem.b + problem.R * solution.impulse
    force = float(np.abs(solution.impulse).max()) or 1.0
    for i, (own, mu) in enumerate(zip(contact, problem.mu, strict=True)):
        A[nv + own] = _mode(dc[own], dx[own], c[i], solution.impulse[i], mu, force, problem.speed, relaxed)
    if np.linalg.cond(A) > 1e12:
        raise Unclear("redundant contacts")
    right = np.zeros((nv + m, nv))
    right[:nv] = problem.M
    return np.asarray(np.linalg.solve(A, right)[:nv], dtype=np.float64)


def _mode(dc: Array, dx: Array, c: Array, x: Array, mu: float, force: float, speed: float, relaxed: bool) -> Array:
    """Rows (1 + nt, nv + m) of one contact whose product with (dv', dlambda) is zero."""
    slip, friction = float(np.linalg.norm(c[1:])), float(np.linalg.norm(x[1:]))
    if x[0] < CLEAR * force:
        if c[0] - (mu * slip if relaxed else 0.0) < CLEAR * speed:
            raise Unclear("a contact just touches")
        return dx
    if mu == 0:
        return np.vstack([dc[:1], dx[1:]])
    if slip < CLEAR * speed:
        if friction > mu * x[0] * (1 - CLEAR):
            raise Unclear("a contact just sticks")
        return dc
    if friction < mu * x[0] * (1 - 1e-3):
        raise Unclear("neither sticking nor sliding: the answer has not converged")
    t = c[1:] / slip
    turning = (np.eye(len(t)) - np.outer(t, t)) @ dc[1:] / slip
    normal = dc[0] - (mu * t @ dc[1:] if relaxed else 0.0)
    return np.vstack([normal, dx[1:] + mu * (np.outer(t, dx[0]) + x[0] * turning)])


def pyramid_derivative(program: Program) -> Array:
    """dv'/dv_free (nv, nv) of the relaxation with the friction pyramid of ``program``; DAQP finds the active rows.

    Raises Unclear where active rows are dependent or a multiplier is small but not zero.
    """
    from cmbrl.contact.solvers.daqp import lay_out

    nv = len(program.problem.v_free)
    multipliers = lay_out(program)(1e-14)(program.offset).multipliers
    largest = float(multipliers.max(initial=0.0))
    active = multipliers > CLEAR * largest
    if (multipliers[~active] > 1e-12 * max(largest, 1e-300)).any():
        raise Unclear("a multiplier is nearly zero")
    C = program.C[active]
    lifted = np.linalg.solve(program.H, C.T)
    gram = C @ lifted
    if active.any() and np.linalg.cond(gram) > 1e12:
        raise Unclear("redundant rows")
    return (np.eye(len(program.H)) - lifted @ np.linalg.solve(gram, C))[:nv, :nv]
