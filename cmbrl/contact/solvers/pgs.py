"""Projected Gauss-Seidel: for each contact in turn, projects first the normal impulse, then friction.

Friction is projected onto the disc of radius mu gamma (exact cone, no pyramid), so a fixed point obeys the exact law
without De Saxce's shift (Jourdan, Alart and Jean 1998). On a stack of two masses, a sweep contracts the error by
1 / (1 + m_bottom / m_top): heavy on light converges slowly, which is inherent to the method. The loop is in Python,
because the matrices are too small for vectorisation to pay.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import hypot

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers.contact_space import ContactSpace
from cmbrl.contact.solvers.protocol import Finish, Law, Run, Solution, Solver

SWEEPS = 1000


@dataclass(frozen=True)
class ProjectedGaussSeidel(Solver):
    """At most ``sweeps``; stops when the natural map is below the tolerance (checked once impulses change less)."""

    sweeps: int = SWEEPS
    name: str = "pgs"
    law: Law = "exact"

    def prepare(self, problem: ContactProblem) -> Run:
        space = ContactSpace.of(problem)
        contacts = _contacts(space)

        def run(tolerance: float) -> Finish:
            x, used, ok = np.zeros(len(space.g)), 0, False
            while used < self.sweeps and not ok:
                used += 1
                if sweep(contacts, x) <= tolerance:
                    ok = space.natural_map(x) <= tolerance
            return partial(_finish, problem, space, x, used, ok)

        return run


def _finish(problem: ContactProblem, space: ContactSpace, x: Array, used: int, ok: bool) -> Solution:
    return Solution.of_impulse(problem, space.impulse(x), used, ok)


Contact = tuple[slice, Array, list[float], list[list[float]], float, float, float]


def _contacts(space: ContactSpace) -> list[Contact]:
    """For each contact: its entries, rows of G, g, block of G, 1 / G_nn, friction step, mu."""
    out: list[Contact] = []
    for i, mu in enumerate(space.mu):
        own = slice(i * space.rows, (i + 1) * space.rows)
        block = space.G[own, own]
        friction = float(np.linalg.eigvalsh(block[1:, 1:])[-1])
        out.append(
            (own, np.ascontiguousarray(space.G[own]), space.g[own].tolist(), block.tolist(),
             1 / max(float(block[0, 0]), 1e-300), 1 / max(friction, 1e-300), float(mu))
        )  # fmt: skip
    return out


def sweep(contacts: list[Contact], x: Array) -> float:
    """One in-place pass over all contacts; returns the largest change of an entry."""
    change = 0.0
    for own, G, g, block, normal_step, friction_step, mu in contacts:
        c, old = (G @ x).tolist(), x[own].tolist()
        normal = max(old[0] - (c[0] + g[0]) * normal_step, 0.0)
        moved = normal - old[0]
        new = [normal] + [0.0] * (len(g) - 1)
        if mu > 0:
            for t in range(1, len(g)):
                new[t] = old[t] - (c[t] + g[t] + block[t][0] * moved) * friction_step
            size = hypot(*new[1:])
            if size > mu * normal:
                for t in range(1, len(g)):
                    new[t] *= mu * normal / size
        x[own] = new
        for a, b in zip(new, old, strict=True):
            change = max(change, abs(a - b))
    return change
