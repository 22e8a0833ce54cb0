"""ADMM on the complementarity problem over impulses, as in Simple and Pinocchio (Carpentier, Le Lidec, Montaut 2024).

x-step: (G + (mu_p + tau rho) 1) x = -(g + s - tau rho y - mu_p x - z); y = P_K(x - z/(tau rho));
z -= tau rho (x - y); s = mu |z_t| e_n. G is diagonalised once, so a new rho costs no factorisation. rho = sqrt(L m)
(L/m)^p; the power p changes by 0.05 if the primal and dual residuals differ more than tenfold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from cmbrl.contact.certificates import project
from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers.contact_space import ContactSpace
from cmbrl.contact.solvers.protocol import Finish, Law, Run, Solution, Solver

PROXIMAL = 1e-6
TAU = 0.5
RATIO = 10.0
POWER, POWER_STEP = 0.2, 0.05
ITERATIONS = 5000


@dataclass(frozen=True)
class AlternatingDirections(Solver):
    """Stops when the primal and dual residuals are below the tolerance, or after ``iterations``."""

    iterations: int = ITERATIONS
    name: str = "admm"
    law: Law = "exact"

    def prepare(self, problem: ContactProblem) -> Run:
        space = ContactSpace.of(problem)

        def run(tolerance: float) -> Finish:
            y, used, ok = solve(space, tolerance, self.iterations)
            return lambda: Solution.of_impulse(problem, space.impulse(y), used, ok)

        return run


def solve(space: ContactSpace, tolerance: float, iterations: int) -> tuple[Array, int, bool]:
    """Impulses (m,) inside the cones, iterations used, and whether both residuals are below the tolerance."""
    values, vectors = np.linalg.eigh(space.G)
    scale = max(float(values[-1]), 1e-300)  # of the natural map: residuals of c count as impulses of c / G
    lowest = PROXIMAL * scale
    inverse = partial(_inverse, values, vectors)
    power, mu = POWER, space.mu
    weight = TAU * _rho(scale, lowest, power)
    step = inverse(lowest + weight)
    x = y = z = np.zeros(len(space.g))
    shape = (-1, space.rows)
    for used in range(1, iterations + 1):
        shifted = space.g - z
        shifted[:: space.rows] += mu * np.linalg.norm(z.reshape(shape)[:, 1:], axis=1)
        last_x, last_y = x, y
        x = step @ (weight * y + lowest * x - shifted)
        y = project((x - z / weight).reshape(shape), mu).ravel()
        z = z - weight * (x - y)
        primal = float(np.abs(x - y).max())
        dual = float(np.abs(lowest * (x - last_x) + weight * (y - last_y)).max()) / scale
        if primal <= tolerance and dual <= tolerance:
            return y, used, True
        if primal > RATIO * dual or dual > RATIO * primal:
            power += POWER_STEP if primal > dual else -POWER_STEP
            power = min(max(power, -1.0), 1.0)
            weight = TAU * _rho(scale, lowest, power)
            step = inverse(lowest + weight)
    return y, iterations, False


def _rho(largest: float, lowest: float, power: float) -> float:
    return (largest * lowest) ** 0.5 * (largest / lowest) ** power


def _inverse(values: Array, vectors: Array, shift: float) -> Array:
    return (vectors / (values + shift)) @ vectors.T
