"""What kappa costs and buys in our softened law: bias of a resting mass, and how fast its gradient may change.

A point of 1 kg at g = 9.81, h = 1 ms, one batch of solves; lines are the closed forms. kappa is shown as kappa/(m g h
times 1 m/s), in which the speed at which a resting mass hovers equals it in m/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.studies.solvers.bank import G, H, problem
from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers.native import solve
from cmbrl.files import atomic_path

MU, GAP, LOAD = 0.5, 1e-4, 0.5  #: friction; gap [m] of the impulse at a distance; share of the friction bound
GRID = 81  # points across the switch, for the second difference: finer ones only resolve the solver's tolerance


@dataclass(frozen=True)
class KappaCurves:
    """By kappa [J], (k,) each, measured and closed form: hover [m/s], creep [m/s], impulse at a distance relative to
    m g h, largest |d2 impulse / dz2| [kg s / m]."""

    kappa: Array
    measured: dict[str, Array]
    closed: dict[str, Array]

    def worst(self) -> float:
        """Largest relative difference between measured and closed form."""
        return max(float(np.abs(self.measured[k] / self.closed[k] - 1).max()) for k in self.closed)


def kappa_curves(points: int = 11) -> KappaCurves:
    """From 1e-8 to 1 times m g h (1 m/s)."""
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
    return KappaCurves(kappa, measured, closed)


def plot(curves: KappaCurves, path: Path) -> None:
    """Bias on the left, Lipschitz constant of the gradient on the right."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    x = curves.kappa / (G * H)
    names = {"hover": "hover speed of a resting mass [m/s]", "creep": "creep of a loaded block [m/s]",
             "impulse at a distance": f"impulse at {1e3 * GAP:g} mm / (m g h)"}  # fmt: skip
    for k, (key, label) in enumerate(names.items()):
        left.plot(x, curves.measured[key], "os^"[k], color=f"C{k}", label=label)
        left.plot(x, curves.closed[key], "-", color=f"C{k}", linewidth=1)
    right.plot(x, curves.measured["Lipschitz"], "D", color="C3", label="largest |d² impulse / d speed²| [kg s/m]")
    right.plot(x, curves.closed["Lipschitz"], "-", color="C3", linewidth=1, label="1 / (4 G^{3/2} √κ)")
    left.set_title("bias (lines: closed forms)", fontsize="medium")
    right.set_title("Lipschitz constant of the gradient", fontsize="medium")
    for axes in (left, right):
        axes.set(xscale="log", yscale="log", xlabel="κ / (m g h · 1 m/s)")
        axes.grid(alpha=0.25)
        axes.legend(frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def _point(v: tuple[float, float], gap: float = 0.0) -> ContactProblem:
    J = np.array([[[0.0, 1.0], [1.0, 0.0]]])
    return problem("point", np.eye(2), J, np.array(v), np.array([MU]), np.array([[gap / H, 0.0]]), family="kappa")


def _curvature(kappa: float) -> float:
    """Largest second difference of the impulse in the closing speed, over the width where the law bends."""
    z = np.linspace(-2, 2, GRID) * np.sqrt(kappa)
    impulse = solve([_point((0.0, speed)) for speed in z], kappa).impulse[:, 0, 0]
    return float(np.abs(np.diff(impulse, 2)).max() / (z[1] - z[0]) ** 2)
