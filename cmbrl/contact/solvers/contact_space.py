"""The exact law in impulses only, without units: c = G x + g, K_mu contains x, c obeys Signorini and Coulomb.

G is the Delassus matrix with compliance on its diagonal. Impulses are in units of |M v_free| / n and speeds in units of
the problem's, so that the natural map here equals the one in the certificates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.contact.certificates import project
from cmbrl.contact.problem import Array, ContactProblem


@dataclass(frozen=True)
class ContactSpace:
    """G (m, m), g (m,) with rows (normal, tangents) contact by contact, mu (n,); ``force`` [N s] scales x."""

    G: Array
    g: Array
    mu: Array
    rows: int
    step: Array
    force: float

    @classmethod
    def of(cls, problem: ContactProblem) -> ContactSpace:
        """From a problem with at least one contact."""
        delassus = problem.delassus()
        diagonal = (np.diag(delassus).reshape(problem.b.shape) + problem.R).max(axis=1, keepdims=True)
        momentum = float(np.linalg.norm(problem.M @ problem.v_free))
        force = momentum / len(problem.mu) or problem.speed / float(diagonal.max())
        scale = force / problem.speed
        return cls(
            (delassus + np.diag(problem.R.ravel())) * scale, problem.free_contact_velocity().ravel() / problem.speed,
            problem.mu, problem.b.shape[1], 1 / np.maximum(diagonal * scale, 1e-300), force,
        )  # fmt: skip

    def natural_map(self, x: Array) -> float:
        """|x - P_K(x - a (c + mu |c_t| e_n))| at x (m,)."""
        c = (self.G @ x + self.g).reshape(-1, self.rows)
        c[:, 0] += self.mu * np.linalg.norm(c[:, 1:], axis=1)
        impulse = x.reshape(-1, self.rows)
        return float(np.linalg.norm(impulse - project(impulse - self.step * c, self.mu)))

    def impulse(self, x: Array) -> Array:
        """lambda (n, 1 + nt) [N s]."""
        return x.reshape(-1, self.rows) * self.force
