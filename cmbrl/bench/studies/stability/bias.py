"""F30, our own bias: what kappa does to contact, measured and in closed form.

With a smoothed contact, impulse times relative velocity is kappa instead of 0; the closed forms follow from that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import atan, cos, inf, sin, sqrt

import numpy as np
from matplotlib.figure import Figure

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.peers.ours import Ours
from cmbrl.bench.peers.simulator import World
from cmbrl.bench.studies.stability.case import WORDS, G
from cmbrl.bench.studies.stability.worlds import GROUND, body, sphere, tilted, world
from cmbrl.bench.study import Cell, Table
from cmbrl.contact.smoothing import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.native_step.result import StepResult

MASS, RADIUS, MU, H = 2.0, 0.1, 0.5, 1e-3
SETTLED = 3000  #: steps until nothing changes any more
DISTANCE = 0.01  #: [m] of the impulse at a distance
INCLINE = atan(0.9 * MU)  #: of the creep
KAPPAS = tuple(float(k) for k in np.logspace(-10, -4, 7))  #: [J]
COLOURS = ("#084594", "#d94801", "#238b45", "#7a0177")
Pairs = Sequence[Sequence[float]]  #: (kappas, 2): measured, closed form


@dataclass(frozen=True)
class Effect:
    """``measured(kappa)`` from our step, ``formula(kappa)`` in closed form, both in ``unit``."""

    unit: str
    measured: Callable[[float], float]
    formula: Callable[[float], float]


def _model(kappa: float, gravity: tuple[float, float, float] = (0, 0, -G)) -> ComplementarityModel:
    ball = body("ball", (0, 0, RADIUS), "xz", sphere("ball", RADIUS, MASS))
    simulator = Ours(World(world(GROUND, ball, mu=MU, gravity=gravity)), smoothing=Barrier(kappa))
    return simulator.model(H).with_settings(path_tolerance=1e-10, prune=inf)


def _step(model: ComplementarityModel, q: np.ndarray, v: np.ndarray) -> StepResult:
    return model.predict(q[None], v[None], np.zeros((1, 0)), impulse=True)


def _settled(model: ComplementarityModel) -> tuple[np.ndarray, np.ndarray]:
    q, v = np.zeros(2), np.zeros(2)
    for _ in range(SETTLED):
        r = _step(model, q, v)
        q, v = r.q_next[0], r.v_next[0]
    return q, v


def _impulse(model: ComplementarityModel, height: float) -> float:
    impulse = _step(model, np.array([0.0, height]), np.zeros(2)).impulse
    assert impulse is not None
    return float(impulse[0, 0, 0])


def _distance_formula(kappa: float) -> float:
    z = DISTANCE / H - G * H  # the impulse itself solves gamma (z + gamma/m) = kappa
    return 2 * kappa / (z + sqrt(z**2 + 4 * kappa / MASS))


def _creep_formula(kappa: float) -> float:
    friction, cone = MASS * G * H * sin(INCLINE), MU * MASS * G * H * cos(INCLINE)
    return kappa * friction / (cone**2 - friction**2)


EFFECTS = {
    "hover of a resting ball, kappa/(m g)": Effect("m", lambda k: _settled(_model(k))[0][1], lambda k: k / (MASS * G)),
    "creep at 0.9 of the friction, kappa beta/((mu gamma)^2 - beta^2)": Effect(
        "m/s", lambda k: _settled(_model(k, tilted(INCLINE)))[1][0], _creep_formula
    ),
    "impulse at 1 cm, kappa/(phi/h + u_n)": Effect("N s", lambda k: _impulse(_model(k), DISTANCE), _distance_formula),
    "impulse of a graze, sqrt(kappa/G)": Effect(
        "N s", lambda k: _impulse(_model(k, (0, 0, 0)), 0.0), lambda k: sqrt(k * MASS)
    ),
}


def measure(effect: str) -> Pairs:
    """One of :data:`EFFECTS` at all kappas."""
    found = EFFECTS[effect]
    return [(float(found.measured(k)), found.formula(k)) for k in KAPPAS]


def table(found: Mapping[str, Pairs]) -> Table:
    """Worst deviation from the closed form over all kappas, and the size at the smallest and largest."""
    rows: list[list[Cell]] = []
    for name, pairs in found.items():
        measured, formula = np.array(pairs).T
        worst = float(np.abs(measured / formula - 1).max())
        verdict = "pass" if worst < 0.01 else "FAIL"
        rows.append([name, EFFECTS[name].unit, float(measured[0]), float(measured[-1]), worst, verdict])
    columns = ["effect", "unit", f"at {KAPPAS[0]:.0e} J", f"at {KAPPAS[-1]:.0e} J", "worst deviation", "within 1 %"]
    note = WORDS("tables.bias", mass=MASS, h=H, mu=MU)
    return Table("F30, our own bias: measured against closed form", columns, rows, note)


def plot(found: Mapping[str, Pairs]) -> Figure:
    """Measured (dots) on the closed forms (lines), against kappa in units of m g h * 1 m/s."""
    figure, grid = panels(1, 1, 7.5, 4.2)
    axes, x = grid[0, 0], np.array(KAPPAS) / (MASS * G * H)
    for (name, pairs), colour in zip(found.items(), COLOURS, strict=True):
        measured, formula = np.array(pairs).T
        axes.loglog(x, formula, "-", color=colour, lw=1.2)
        axes.loglog(x, np.abs(measured), "o", color=colour, ms=5, label=f"{name} [{EFFECTS[name].unit}]")
    axes.set_xlabel("kappa / (m g h · 1 m/s)")
    axes.set_ylabel("bias (unit in the legend)")
    axes.grid(alpha=0.3)
    legend_below(figure, ncols=1)
    return figure
