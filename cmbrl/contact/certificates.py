"""How well velocities and impulses satisfy the contact laws, recomputed from the problem itself: no solver's own flag.

Rows of a contact are (normal, tangents); impulses lambda (n, 1 + nt), nt = 1 in the plane and 2 in space. With
c = J v' + b + R lambda the exact law is  K_mu contains lambda, perpendicular to c + mu |c_t| e_n, in the dual cone
(De Saxce and Feng 1998). The natural map measures all of it at once; the rest says which part fails.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """One contact problem  M (v' - v_free) = J^T lambda  with the laws of n contacts.

    M (nv, nv), J (n, 1 + nt, nv), v_free (nv,) [m/s], gap_term b (n,) [m/s] of the normal rows, mu (n,);
    R (n, 1 + nt) [1/kg] compliance of the rows, zero for rigid contact.
    """

    M: Array
    J: Array
    v_free: Array
    gap_term: Array
    mu: Array
    R: Array | float = 0.0

    def __post_init__(self) -> None:
        n, nv = len(self.J), len(self.v_free)
        if self.J.ndim != 3 or self.J.shape[2] != nv or self.M.shape != (nv, nv):
            raise ValueError(f"M {self.M.shape}, J {self.J.shape} and v_free ({nv},) do not belong together")
        if np.shape(self.gap_term) != (n,) or np.shape(self.mu) != (n,):
            raise ValueError(f"gap_term and mu must have one entry for each of the {n} contacts")


@dataclass(frozen=True)
class Residuals:
    """Zero means: momentum balance; the next gap is not negative; no force at a distance; inside the friction cone;
    friction opposes slip and is at its bound while slipping; all laws at once. Impulses relative to |M v_free| / n,
    speeds to ``speed``, products to both."""

    dynamics: float
    penetration: float
    signorini: float
    cone: float
    dissipation: float
    natural_map: float

    def worst(self) -> float:
        """The largest of all."""
        return max(asdict(self).values())


def residuals(problem: Problem, v_next: Array, impulse: Array, speed: float) -> Residuals:
    """Scores v' (nv,), lambda (n, 1 + nt); ``speed`` [m/s]: what velocities are compared with, max(g h, |u|)."""
    momentum = problem.M @ problem.v_free
    error = problem.M @ (v_next - problem.v_free) - np.einsum("crv,cr->v", problem.J, impulse)
    scale = max(float(np.linalg.norm(momentum)), 1e-300)
    dynamics = float(np.linalg.norm(error)) / scale
    if not len(impulse):
        return Residuals(dynamics, 0.0, 0.0, 0.0, 0.0, 0.0)
    force = scale / len(impulse)
    c = problem.J @ v_next + problem.R * impulse
    c[:, 0] += problem.gap_term
    normal, friction, slip = impulse[:, 0], impulse[:, 1:], np.linalg.norm(c[:, 1:], axis=1)
    power = (friction * c[:, 1:]).sum(axis=1) + problem.mu * normal * slip
    return Residuals(
        dynamics=dynamics,
        penetration=float(np.maximum(-c[:, 0], 0.0).max()) / speed,
        signorini=float(np.abs(normal * c[:, 0]).max()) / (force * speed),
        cone=float(np.maximum(np.linalg.norm(friction, axis=1) - problem.mu * normal, 0.0).max()) / force,
        dissipation=float(np.abs(power).max()) / (force * speed),
        natural_map=float(np.linalg.norm(_natural_map(problem, c, impulse))) / force,
    )


def project(x: Array, mu: Array) -> Array:
    """Projection (n, 1 + nt) of x on the friction cones {|x_t| <= mu x_n}; mu = 0 leaves the normal half line."""
    normal, tangent = x[:, 0], x[:, 1:]
    size = np.linalg.norm(tangent, axis=1)
    head = np.maximum((mu * size + normal) / (1 + mu**2), 0.0)
    direction = tangent / np.maximum(size, 1e-300)[:, None]
    onto = np.column_stack([head, (mu * head)[:, None] * direction])
    inside = size <= mu * normal
    return np.where(inside[:, None], x, onto)


def _natural_map(problem: Problem, c: Array, impulse: Array) -> Array:
    solved = np.linalg.solve(problem.M, problem.J.reshape(-1, len(problem.v_free)).T)
    diagonal = np.einsum("rv,vr->r", problem.J.reshape(-1, len(problem.v_free)), solved).reshape(impulse.shape)
    step = 1.0 / np.maximum(diagonal.max(axis=1, keepdims=True), 1e-300)
    shifted = c.copy()
    shifted[:, 0] += problem.mu * np.linalg.norm(c[:, 1:], axis=1)
    return impulse - project(impulse - step * shifted, problem.mu)
