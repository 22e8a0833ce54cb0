"""What kappa costs and buys in our softened law: bias of a resting mass, and how fast its gradient can change.

A point of 1 kg at g = 9.81 m/s^2 and h = 1 ms, solved in one batch, next to closed forms.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.bench.studies.solvers.hard_cases import G, H, problem
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers.native import solve

MU, GAP, LOAD = 0.5, 1e-4, 0.5  #: friction; gap [m] of the impulse at a distance; share of the friction bound
GRID = 81  # points across the switch for the second difference; a finer grid resolves only the solver's tolerance


def kappa_curves(points: int = 11) -> dict[str, Any]:
    """By kappa [J] (points,), from 1e-8 to 1 times m g h (1 m/s), "measured" and "closed" form of: hover and creep
    [m/s], impulse at a distance relative to m g h, Lipschitz: largest |d2 impulse / dz2| [kg s / m]."""
    kappa = np.logspace(-8, 0, points) * G * H
    rest = solve([_point((0.0, -G * H))] * points, kappa)
    loaded = solve([_point((LOAD * MU * G * H, -G * H))] * points, kappa)
    away = solve([_point((0.0, 0.0), GAP)] * points, kappa)
    normal, friction = loaded.impulse[:, 0, 0], -loaded.impulse[:, 0, 1]
    measured = {
        "hover": rest.v[:, 1],
        "creep": loaded.v[:, 0],
        "impulse at a distance": away.impulse[:, 0, 0] / (G * H),
        "Lipschitz": np.array([_curvature(k) for k in kappa]),
    }
    closed = {
        "hover": kappa / rest.impulse[:, 0, 0],
        "creep": kappa * friction / ((MU * normal) ** 2 - friction**2),
        "impulse at a distance": kappa / (GAP / H + away.v[:, 1]) / (G * H),
        "Lipschitz": 1 / (4 * np.sqrt(kappa)),
    }
    worst = max(float(np.abs(measured[k] / closed[k] - 1).max()) for k in closed)
    return {"kappa": kappa, "measured": measured, "closed": closed, "worst": worst}


def _point(v: tuple[float, float], gap: float = 0.0) -> ContactProblem:
    J = np.array([[[0.0, 1.0], [1.0, 0.0]]])
    return problem("point", np.eye(2), J, np.array(v), np.array([MU]), np.array([[gap / H, 0.0]]), family="kappa")


def _curvature(kappa: float) -> float:
    """Largest second difference of the impulse in the closing speed, over the width in which the law bends."""
    z = np.linspace(-2, 2, GRID) * np.sqrt(kappa)
    impulse = solve([_point((0.0, speed)) for speed in z], kappa).impulse[:, 0, 0]
    return float(np.abs(np.diff(impulse, 2)).max() / (z[1] - z[0]) ** 2)
