"""Work-precision by family and performance profiles; who fails is shown by number, not left out."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.studies.solvers.summary import LEVELS, Summary
from cmbrl.files import atomic_path

FLOOR, CEILING = 1e-17, 1e1  #: residuals are drawn inside these
#: exact law: strong colours, full lines; the relaxation: grey to brown, dashed
STYLES: dict[str, tuple[str, str, str]] = {
    "ours": ("#d62728", "-", "o"),
    "ours softened": ("#ff9896", ":", "o"),
    "pgs": ("#1f77b4", "-", "v"),
    "admm": ("#17becf", "-", "^"),
    "pinocchio admm": ("#2ca02c", "-", "s"),
    "pinocchio pgs": ("#98df8a", "-", "D"),
    "desaxce": ("#9467bd", "-", "P"),
    "desaxce proxsuite": ("#e377c2", "-", "X"),
    "desaxce clarabel": ("#ff7f0e", "-", "*"),
    "convex": ("black", "--", "P"),
    "proxsuite": ("0.35", "--", "X"),
    "clarabel": ("0.5", "--", "*"),
    "pinocchio admm convex": ("#8c564b", "--", "s"),
}
LABELS = {"convex": "daqp (relaxation)", "proxsuite": "proxqp (relaxation)", "clarabel": "clarabel (relaxation)",
          "pinocchio admm convex": "pinocchio admm (relaxation)", "desaxce": "daqp, De Saxcé loop",
          "desaxce proxsuite": "proxqp, De Saxcé loop", "desaxce clarabel": "clarabel, De Saxcé loop"}  # fmt: skip


def style(solver: str) -> dict[str, object]:
    """Colour, line and marker of a solver, the same in every chart."""
    colour, line, marker = STYLES.get(solver, ("0.75", ":", "."))
    heavy = solver == "ours"
    return {"color": colour, "linestyle": line, "marker": marker, "markersize": 6 if heavy else 4,
            "linewidth": 2.2 if heavy else 1.1, "zorder": 5 if heavy else 3,
            "label": LABELS.get(solver, solver)}  # fmt: skip


def work_precision(summary: Summary, path: str | os.PathLike[str]) -> None:
    """Exact law: microseconds against the 90th percentile of the residual, one panel a family."""
    shown = [s for s in summary.solvers if s in STYLES]
    _panels(summary, shown, "exact", "residual on the exact law, 90th percentile", path)


def relaxed_precision(summary: Summary, path: str | os.PathLike[str]) -> None:
    """The relaxation's own complementarity, for the solvers that aim at it."""
    shown = [s for s in summary.solvers if summary.laws[s] == "convex"]
    _panels(summary, shown, "convex", "power, momentum, penetration: 90th percentile", path)


def _panels(summary: Summary, shown: list[str], measure: str, label: str, path: str | os.PathLike[str]) -> None:
    families = list(summary.families)
    figure = Figure(figsize=(13, 3.4 * -(-len(families) // 4) + 1), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(-(-len(families) // 4), min(4, len(families)), squeeze=False, sharey=True).ravel()
    for axes, family in zip(grid, families, strict=False):
        problems = summary.families[family]
        for solver in shown:
            time, residual = summary.curve(solver, problems, measure)
            axes.plot(time, np.clip(residual, FLOOR, CEILING), **_own(solver, shown))
        axes.axhspan(1e-1, CEILING * 3, color="0.5", alpha=0.08)
        axes.set(xscale="log", yscale="log", ylim=(FLOOR / 3, CEILING * 3), xlabel="µs per solve")
        axes.set_title(f"{family} ({len(problems)} problems)", fontsize="medium")
        axes.grid(alpha=0.25)
    for axes in grid[len(families) :]:
        axes.set_axis_off()
    for axes in grid[:: min(4, len(families))]:
        axes.set_ylabel(label, fontsize="small")
    _save(figure, grid[0], path)


def profile(summary: Summary, path: str | os.PathLike[str]) -> None:
    """Share of all feasible problems solved within a factor of the fastest solver, at both levels."""
    shown = [s for s in summary.solvers if s in STYLES]
    problems = [name for family in summary.families.values() for name in family]
    figure = Figure(figsize=(12, 5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(LEVELS), sharey=True)
    for axes, level in zip(grid, LEVELS, strict=True):
        times = {solver: summary.times(solver, level) for solver in shown}
        best = {name: min((t[name] for t in times.values() if name in t), default=np.inf) for name in problems}
        for solver, solved in times.items():
            ratio = np.sort([seconds / best[name] for name, seconds in solved.items()])
            share = np.arange(1, len(ratio) + 1) / len(problems)
            look = style(solver) | {"marker": None, "drawstyle": "steps-post"}
            look["label"] = f"{look['label']}: {len(problems) - len(ratio)} failed"
            axes.plot([*ratio, 1e4], [*share, share[-1] if len(share) else 0.0], **look)
        axes.set(xscale="log", xlim=(1, 1e4), ylim=(-0.02, 1.02), xlabel="time / time of the fastest on that problem")
        axes.set_title(f"solved: residual on the exact law below {level:g}", fontsize="medium")
        axes.grid(alpha=0.25)
        axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, frameon=False)
    grid[0].set_ylabel(f"share of the {len(problems)} feasible problems")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def _own(solver: str, shown: list[str]) -> dict[str, object]:
    """Its style; solvers without one of their own get one by their place."""
    if solver in STYLES:
        return style(solver)
    k = shown.index(solver)
    return style(solver) | {"color": f"C{k % 10}", "marker": "o^sDv<>ph"[k % 9]}


def _save(figure: Figure, axes: Axes, path: str | os.PathLike[str]) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


FIGURES: dict[str, Callable[[Summary, Path], None]] = {
    "work_precision.png": work_precision, "profile.png": profile, "relaxed.png": relaxed_precision
}  # fmt: skip
