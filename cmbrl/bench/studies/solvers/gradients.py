"""Who differentiates a contact step how fast and how exactly: w' dv'/dv_free, judged by the law that each one solves.

Times are processor time of the process for one product, solve included. Errors are relative to the reference of
reference.py for the rival's own law; the table adds the distance of that derivative from the exact law's, which no
setting of a relaxation removes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.studies.solvers.bank import G, H, problem
from cmbrl.bench.studies.solvers.gradient_rivals import Rival, rivals
from cmbrl.bench.studies.solvers.problems import family
from cmbrl.bench.studies.solvers.reference import Unclear, cone_derivative, pyramid_derivative
from cmbrl.bench.study import Table
from cmbrl.bench.timing import interleaved
from cmbrl.contact.problem import Array, ContactProblem
from cmbrl.contact.solvers import available, get
from cmbrl.contact.solvers.formulation import pyramid
from cmbrl.files import atomic_path

SCENES = ("cheetah", "cube", "g1 feet", "random")
TURNS, QUICK_TURNS = 7, 2
LOOK = {  # colour, marker; round cones and the exact law full, pyramids hollow
    "ours, implicit": ("#d62728", "o"), "ours, implicit, softened": ("#ff9896", "o"),
    "ours, central differences": ("#9467bd", "s"), "daqp, central differences": ("black", "P"),
    "proxqp, its own backward": ("#1f77b4", "X"), "proxqp, torch layer": ("#17becf", "X"),
    "cvxpylayers": ("#2ca02c", "D"),
}  # fmt: skip
FLOOR = 1e-16


@dataclass(frozen=True)
class Point:
    """One rival at one setting on one problem. ``error``: distance from the derivative of its own law, ``model``:
    distance of that one from the exact law's."""

    scene: str
    rival: str
    setting: float
    seconds: float
    error: float
    model: float


def sliding_block() -> ContactProblem:
    """A point of 1 kg in space sliding at 1 m/s: du_n/dv_free = (0, mu, mu^2)/(1 + mu^2) under the relaxation."""
    J = np.eye(3)[None, [2, 0, 1]]
    return problem("sliding block", np.eye(3), J, np.array([0.0, 1.0, -G * H]), np.array([0.4]), family="gradient")


def references(problem: ContactProblem) -> dict[str, Array]:
    """dv'/dv_free (nv, nv) by law, as far as what solves it is installed; raises Unclear where one has none."""
    out = {"exact": cone_derivative(problem, get("ours").solve(problem, 1e-12))}
    installed = available("convex")
    relaxed = next((name for name in ("pinocchio admm convex", "clarabel") if name in installed), None)
    if relaxed:
        out["round"] = cone_derivative(problem, get(relaxed).solve(problem, 1e-13), relaxed=True)
    if "convex" in installed:
        out["pyramid"] = pyramid_derivative(pyramid(problem))
    return out


def chosen(problems: Sequence[ContactProblem]) -> dict[str, tuple[ContactProblem, dict[str, Array]]]:
    """The sliding block, and of every scene the first problem where something slides and every law has a derivative."""
    out = {"sliding block": (sliding_block(), references(sliding_block()))}
    for p in problems:
        if family(p) in SCENES and family(p) not in out and _slides(p):
            try:
                out[family(p)] = p, references(p)
            except Unclear:
                continue
    return out


def _slides(problem: ContactProblem) -> bool:
    found = get("ours").solve(problem, 1e-12)
    slip = np.linalg.norm((problem.J @ found.v + problem.b + problem.R * found.impulse)[:, 1:], axis=1)
    return found.ok and bool(((slip > 1e-3 * problem.speed) & (found.impulse[:, 0] > 0) & (problem.mu > 0)).any())


def measure_gradients(problems: Sequence[ContactProblem], seed: int, quick: bool) -> list[Point]:
    """All rivals at all their settings on every chosen problem."""
    points = []
    for scene, (p, reference) in chosen(problems).items():
        w = np.random.default_rng(seed).normal(size=len(p.v_free))
        for rival in (r for r in rivals() if r.law in reference):
            points += _points(scene, p, reference, rival, w, QUICK_TURNS if quick else TURNS)
    return points


def _points(
    scene: str, p: ContactProblem, reference: dict[str, Array], rival: Rival, w: Array, turns: int
) -> list[Point]:
    product = rival.lay_out(p, w)
    work = {str(setting): ((lambda s=setting: product(s)), 1) for setting in rival.settings}
    seconds = interleaved(work, turns, clock=time.process_time)
    own, exact = w @ reference[rival.law], w @ reference["exact"]
    return [
        Point(scene, rival.name, setting, float(np.median(seconds[str(setting)])), _distance(product(setting), own),
              _distance(own, exact))
        for setting in rival.settings
    ]  # fmt: skip


def _distance(a: Array, b: Array) -> float:
    """Relative; infinite (and shown at the top) where a rival returned something that is not finite."""
    error = float(np.linalg.norm(a - b) / np.linalg.norm(b))
    return error if np.isfinite(error) else 1e300


def plot(points: list[Point], path: Path) -> None:
    """Time against error, one panel a scene."""
    scenes = list(dict.fromkeys(p.scene for p in points))
    figure = Figure(figsize=(3.2 * len(scenes), 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(scenes), sharey=True, squeeze=False)[0]
    for axes, scene in zip(grid, scenes, strict=True):
        for rival in dict.fromkeys(p.rival for p in points):
            own = [p for p in points if p.scene == scene and p.rival == rival]
            colour, marker = LOOK[rival]
            hollow = {"markerfacecolor": "white"} if rival.startswith(("daqp", "proxqp")) else {}
            axes.plot([1e6 * p.seconds for p in own], [np.clip(p.error, FLOOR, 10) for p in own], color=colour,
                      marker=marker, linewidth=1, markersize=5, label=rival, **hollow)  # fmt: skip
        axes.set(xscale="log", yscale="log", xlabel="µs per product, solve included", ylim=(FLOOR / 3, 30))
        axes.set_title(scene, fontsize="medium")
        axes.grid(alpha=0.25)
    grid[0].set_ylabel("relative error to the derivative of its own law", fontsize="small")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def table(points: list[Point]) -> Table:
    """Each rival at its most exact setting, per scene."""
    laws = {r.name: {"exact": "exact", "round": "relaxation, round cones", "pyramid": "relaxation, pyramid"}[r.law]
            for r in rivals()}  # fmt: skip
    rows: list[list[str | float | None]] = []
    for scene, rival in dict.fromkeys((p.scene, p.rival) for p in points):
        best = min((p for p in points if (p.scene, p.rival) == (scene, rival)), key=lambda p: p.error)
        rows.append([scene, rival, laws[rival], best.setting, 1e6 * best.seconds, best.error, best.model])
    return Table(
        "Derivatives at each rival's most exact setting",
        ["scene", "rival", "law", "setting", "us", "error, own law", "own law - exact law"], rows,
        "Relative error of a vector-Jacobian product with dv'/dv_free. The last column is how far the law that is "
        "differentiated is from Signorini-Coulomb's, in the same norm: no setting removes it.",
    )  # fmt: skip
