"""Our own bias, F30: what kappa does to contact, measured and in closed form (contact.md section 11, derived there)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import atan, cos, sin, sqrt
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.studies.stability.case import Case, G
from cmbrl.bench.studies.stability.ours import model_of
from cmbrl.bench.studies.stability.worlds import GROUND, body, sphere, tilted, world
from cmbrl.bench.study import Table
from cmbrl.contact.smoothing import Barrier
from cmbrl.files import atomic_path
from cmbrl.models.complementarity import ComplementarityModel, StepResult

MASS, RADIUS, MU, H = 2.0, 0.1, 0.5, 1e-3
SETTLED = 3000  #: steps until nothing changes any more
DISTANCE = 0.01  #: [m] of the impulse at a distance
INCLINE = atan(0.9 * MU)  #: of the creep
KAPPAS = tuple(float(k) for k in np.logspace(-10, -4, 7))  #: [J]


@dataclass(frozen=True)
class Bias:
    """``measure(kappa)`` from our step, ``formula(kappa)`` in closed form, both in ``unit``."""

    name: str
    unit: str
    measure: Callable[[float], float]
    formula: Callable[[float], float]


def _model(kappa: float, gravity: tuple[float, float, float] = (0, 0, -G)) -> ComplementarityModel:
    ball = body("ball", (0, 0, RADIUS), "xz", sphere("ball", RADIUS, MASS))
    case = Case("ball", world(GROUND, ball, mu=MU, gravity=gravity), 0.0, lambda run: 0.0)
    model = model_of(case, H, smoothing=Barrier(kappa))
    return model.with_settings(path_tolerance=1e-10, prune=float("inf"))


def _step(model: ComplementarityModel, q: np.ndarray, v: np.ndarray) -> StepResult:
    return model.predict(q[None], v[None], np.zeros((1, 0)), impulse=True)


def _settled(model: ComplementarityModel) -> tuple[np.ndarray, np.ndarray]:
    q, v = np.zeros(2), np.zeros(2)
    for _ in range(SETTLED):
        r = _step(model, q, v)
        q, v = r.q_next[0], r.v_next[0]
    return q, v


def _at_distance(kappa: float) -> float:
    r = _step(_model(kappa), np.array([0.0, DISTANCE]), np.zeros(2))
    assert r.impulse is not None
    return float(r.impulse[0, 0, 0])


def _distance_formula(kappa: float) -> float:
    z = DISTANCE / H - G * H  # the impulse itself solves gamma (z + gamma/m) = kappa
    return 2 * kappa / (z + sqrt(z**2 + 4 * kappa / MASS))


def _creep_formula(kappa: float) -> float:
    friction, cone = MASS * G * H * sin(INCLINE), MU * MASS * G * H * cos(INCLINE)
    return kappa * friction / (cone**2 - friction**2)


def _graze(kappa: float) -> float:
    r = _step(_model(kappa, (0, 0, 0)), np.zeros(2), np.zeros(2))
    assert r.impulse is not None
    return float(r.impulse[0, 0, 0])


BIASES = (
    Bias("hover of a resting ball, kappa/(m g)", "m", lambda k: _settled(_model(k))[0][1], lambda k: k / (MASS * G)),
    Bias("creep at 0.9 of the friction, kappa beta/((mu gamma)^2 - beta^2)", "m/s",
         lambda k: _settled(_model(k, tilted(INCLINE)))[1][0], _creep_formula),
    Bias("impulse at 1 cm, kappa/(phi/h + u_n)", "N s", _at_distance, _distance_formula),
    Bias("impulse of a graze, sqrt(kappa/G)", "N s", _graze, lambda k: sqrt(k * MASS)),
)  # fmt: skip


def measure() -> dict[str, np.ndarray]:
    """Name -> (kappas, 2): measured, closed form."""
    return {b.name: np.array([(b.measure(k), b.formula(k)) for k in KAPPAS]) for b in BIASES}


def table(found: dict[str, np.ndarray]) -> Table:
    """Worst deviation from the closed form over all kappas, and the size at the smallest and largest."""
    rows = []
    for b in BIASES:
        measured, formula = found[b.name].T
        worst = float(np.abs(measured / formula - 1).max())
        rows.append([b.name, b.unit, measured[0], measured[-1], worst, "pass" if worst < 0.01 else "FAIL"])
    columns = ["effect", "unit", f"at {KAPPAS[0]:.0e} J", f"at {KAPPAS[-1]:.0e} J", "worst deviation", "within 1 %"]
    note = f"A ball of {MASS:g} kg, h = {H:g} s, mu = {MU:g}. kappa is impulse times velocity; 0 is hard contact."
    return Table("F30, our own bias: measured against closed form", columns, rows, note)


def plot(found: dict[str, np.ndarray], path: Path) -> None:
    """Measured (dots) on the closed forms (lines), against kappa in units of m g h * 1 m/s."""
    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    x = np.array(KAPPAS) / (MASS * G * H)
    for b, colour in zip(BIASES, ("#084594", "#d94801", "#238b45", "#7a0177"), strict=True):
        axes.loglog(x, found[b.name][:, 1], "-", color=colour, lw=1.2)
        axes.loglog(x, np.abs(found[b.name][:, 0]), "o", color=colour, ms=5, label=f"{b.name} [{b.unit}]")
    axes.set_xlabel("kappa / (m g h · 1 m/s)")
    axes.set_ylabel("bias (unit in the legend)")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=1, frameon=False, fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)
