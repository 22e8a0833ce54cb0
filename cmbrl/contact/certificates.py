"""How well velocities and impulses satisfy the contact laws, computed from the problem, not from a solver's flag.

Rows of a contact are (normal, tangents); impulses lambda (n, 1 + nt), nt = 1 in the plane and 2 in space. With
c = J v' + b + R lambda the exact law is  K_mu contains lambda, perpendicular to c + mu |c_t| e_n, in the dual cone
(De Saxce and Feng 1998); the convex law of sliding leaves the shift mu |c_t| out. The natural map measures everything
at once; the other residuals show which part fails.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem


@dataclass(frozen=True)
class Residuals:
    """Violations, in order: momentum balance; penetration; force at a distance; friction outside its cone; friction
    that does not oppose slip, or is below its bound while slipping; all laws at once (natural map). Impulses are
    relative to |M v_free| / n, speeds to ``problem.speed``, products to both. The gap that a contact keeps under the
    convex law is c_n - mu |c_t|."""

    dynamics: float
    penetration: float
    signorini: float
    cone: float
    dissipation: float
    natural_map: float

    def worst(self) -> float:
        """The largest residual."""
        return max(asdict(self).values())


def residuals(problem: ContactProblem, v_next: Array, impulse: Array) -> Residuals:
    """Residuals of v' (nv,) and lambda (n, 1 + nt) under each contact's law of sliding."""
    momentum = problem.M @ problem.v_free
    error = problem.M @ (v_next - problem.v_free) - np.einsum("crv,cr->v", problem.J, impulse)
    scale = max(float(np.linalg.norm(momentum)), 1e-300)
    dynamics = float(np.linalg.norm(error)) / scale
    if not len(impulse):
        return Residuals(dynamics, 0.0, 0.0, 0.0, 0.0, 0.0)
    force = scale / len(impulse)
    c = problem.J @ v_next + problem.b + problem.R * impulse
    speed = problem.speed
    normal, friction, slip = impulse[:, 0], impulse[:, 1:], np.linalg.norm(c[:, 1:], axis=1)
    gap = c[:, 0] - problem.convex * problem.mu * slip
    power = (friction * c[:, 1:]).sum(axis=1) + problem.mu * normal * slip
    return Residuals(
        dynamics=dynamics,
        penetration=float(np.maximum(-gap, 0.0).max()) / speed,
        signorini=float(np.abs(normal * gap).max()) / (force * speed),
        cone=float(np.maximum(np.linalg.norm(friction, axis=1) - problem.mu * normal, 0.0).max()) / force,
        dissipation=float(np.abs(power).max()) / (force * speed),
        natural_map=float(np.linalg.norm(_natural_map(problem, c, impulse))) / force,
    )


def project(x: Array, mu: Array) -> Array:
    """Projection (n, 1 + nt) of x onto the friction cones {|x_t| <= mu x_n}; for mu = 0, the normal half line."""
    normal, tangent = x[:, 0], x[:, 1:]
    size = np.linalg.norm(tangent, axis=1)
    head = np.maximum((mu * size + normal) / (1 + mu**2), 0.0)
    direction = tangent / np.maximum(size, 1e-300)[:, None]
    onto = np.column_stack([head, (mu * head)[:, None] * direction])
    inside = (size <= mu * normal) & (normal >= 0)
    return np.where(inside[:, None], x, onto)


def _natural_map(problem: ContactProblem, c: Array, impulse: Array) -> Array:
    diagonal = np.diag(problem.delassus()).reshape(impulse.shape) + problem.R  # response of a row to its own impulse
    step = 1.0 / np.maximum(diagonal.max(axis=1, keepdims=True), 1e-300)
    shifted = c.copy()
    shifted[:, 0] += (1 - problem.convex) * problem.mu * np.linalg.norm(c[:, 1:], axis=1)
    return impulse - project(impulse - step * shifted, problem.mu)
