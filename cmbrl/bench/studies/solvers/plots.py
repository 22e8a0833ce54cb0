"""Work-precision by family, performance profiles, derivatives, kappa. Legends count failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.solvers.derivatives import Point
from cmbrl.bench.studies.solvers.hard_cases import G, H
from cmbrl.bench.studies.solvers.kappa import GAP
from cmbrl.bench.studies.solvers.tables import LABELS, LEVELS, Summary
from cmbrl.contact.solvers import Law

FLOOR, CEILING = 1e-14, 1e1  #: errors are drawn inside these
COLUMNS = 4  #: panels in a row
#: exact law: strong colours, full lines; the relaxation: grey to brown, dashed; loops in Python: open markers
STYLES: dict[str, tuple[str, str, str]] = {
    "ours": ("#d62728", "-", "o"), "ours softened": ("#ff9896", ":", "o"),
    "pgs": ("#1f77b4", "-", "v"), "admm": ("#17becf", "-", "^"),
    "pinocchio admm": ("#2ca02c", "-", "s"), "pinocchio pgs": ("#98df8a", "-", "D"),
    "desaxce": ("#9467bd", "-", "P"), "desaxce proxsuite": ("#e377c2", "-", "X"),
    "desaxce clarabel": ("#ff7f0e", "-", "*"), "convex": ("black", "--", "P"),
    "proxsuite": ("0.35", "--", "X"), "clarabel": ("0.5", "--", "*"),
    "pinocchio admm convex": ("#8c564b", "--", "s"),
}  # fmt: skip
GRADIENTS = {
    "cmbrl, implicit": ("#d62728", "o"), "cmbrl, implicit, softened": ("#ff9896", "o"),
    "cmbrl, central differences": ("#9467bd", "s"), "DAQP, central differences": ("black", "P"),
    "ProxQP, own backward pass": ("#1f77b4", "X"), "ProxQP, QPLayer for torch": ("#17becf", "X"),
    "cvxpylayers": ("#2ca02c", "D"),
}  # fmt: skip
PRECISION = 1e-16  #: smaller errors of derivatives are drawn here


def style(solver: str, place: int = 0) -> dict[str, Any]:
    """Colour, line and marker of a solver, the same in every chart; of the others by their place."""
    colour, line, marker = STYLES.get(solver, (f"C{place % 10}", ":", "o^sDv<>ph"[place % 9]))
    look = {"color": colour, "linestyle": line, "marker": marker, "label": LABELS.get(solver, solver)}
    if "Python loop" in str(look["label"]):
        look["markerfacecolor"] = "white"
    heavy = solver == "ours"
    return look | {"markersize": 6 if heavy else 4, "linewidth": 2.2 if heavy else 1.1, "zorder": 5 if heavy else 3}


def precision(summary: Summary, law: Law) -> Figure:
    """Time against error, one panel a family: on the exact law, or on the convex relaxation for solvers of it."""
    shown = [s for s in summary.solvers if (summary.laws[s] == "convex" if law == "convex" else s in STYLES)]
    count = len(summary.families)
    rows, columns = -(-count // COLUMNS), min(COLUMNS, count)
    figure, grid = panels(rows, columns, 3.25 * columns, 3.4 * rows + 1, sharey=True)
    for axes, (family, problems) in zip(grid.ravel(), summary.families.items(), strict=False):
        for place, solver in enumerate(shown):
            time, error = summary.curve(solver, problems, law)
            axes.plot(time, np.clip(error, FLOOR, CEILING), **style(solver, place))
        axes.axhspan(1e-1, CEILING * 3, color="0.5", alpha=0.08)
        axes.set(xscale="log", yscale="log", ylim=(FLOOR / 3, CEILING * 3), xlabel="time of a solve [µs]")
        axes.set_title(f"{family} ({len(problems)} problems)", fontsize="medium")
        axes.grid(alpha=0.25)
    for axes in grid[:, 0]:
        judge = "convex relaxation" if law == "convex" else "exact law"
        axes.set_ylabel(f"error on the {judge},\n90th percentile", fontsize="small")
    spare = grid.ravel()[count:]
    for axes in spare:
        axes.set_axis_off()
    if len(spare):
        spare[0].legend(*grid[0, 0].get_legend_handles_labels(), loc="center", frameon=False, fontsize="small")
    else:
        legend_below(figure)
    return figure


def profile(summary: Summary) -> Figure:
    """Share of all feasible problems solved within a factor of the fastest solver, at both levels."""
    shown = [s for s in summary.solvers if s in STYLES]
    problems = [name for family in summary.families.values() for name in family]
    figure, grid = panels(1, len(LEVELS), 13, 5.2, sharey=True)
    for axes, level in zip(grid[0], LEVELS, strict=True):
        times = {solver: summary.times(solver, level) for solver in shown}
        best = {name: min((t[name] for t in times.values() if name in t), default=np.inf) for name in problems}
        for solver, solved in times.items():
            ratio = np.sort([seconds / best[name] for name, seconds in solved.items()])
            share = np.arange(1, len(ratio) + 1) / len(problems)
            look = style(solver) | {"marker": None, "drawstyle": "steps-post"}
            look["label"] = f"{look['label']}: {len(problems) - len(ratio)} failed"
            axes.plot([*ratio, 1e4], [*share, share[-1] if len(share) else 0.0], **look)
        axes.set(xscale="log", xlim=(1, 1e4), ylim=(-0.02, 1.02), xlabel="time / time of the fastest on that problem")
        axes.set_title(f"solved: error on the exact law below {level:g}", fontsize="medium")
        axes.grid(alpha=0.25)
        axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, frameon=False)
    grid[0, 0].set_ylabel(f"share of the {len(problems)} feasible problems")
    return figure


def derivatives(points: Sequence[Point]) -> Figure:
    """Time of a product against its error, one panel a scene; pyramids have open markers."""
    scenes = list(dict.fromkeys(p.scene for p in points))
    figure, (grid,) = panels(1, len(scenes), 3.2 * len(scenes), 4.6, sharey=True)
    for axes, scene in zip(grid, scenes, strict=True):
        for arm in dict.fromkeys(p.arm for p in points):
            own = [p for p in points if p.scene == scene and p.arm == arm]
            colour, marker = GRADIENTS[arm]
            face = "white" if any(p.law == "pyramid" for p in own) else colour
            axes.plot([1e6 * p.seconds for p in own], [np.clip(p.error, PRECISION, 10) for p in own], color=colour,
                      marker=marker, markerfacecolor=face, linewidth=1, markersize=5, label=arm)  # fmt: skip
        axes.set(xscale="log", yscale="log", xlabel="time of a product [µs]", ylim=(PRECISION / 3, 30))
        axes.set_title(scene, fontsize="medium")
        axes.grid(alpha=0.25)
    grid[0].set_ylabel("relative error to the derivative of its own law", fontsize="small")
    legend_below(figure)
    return figure


def kappa(curves: Mapping[str, Any]) -> Figure:
    """Bias on the left, Lipschitz constant of the gradient on the right; markers measured, lines in closed form."""
    figure, ((left, right),) = panels(1, 2, 11, 4.4)
    x = np.array(curves["kappa"]) / (G * H)
    shown = [
        (left, "hover", "o", "hover speed of a resting mass [m/s]"),
        (left, "creep", "s", "creep of a loaded block [m/s]"),
        (left, "impulse at a distance", "^", f"impulse at {1e3 * GAP:g} mm / (m g h)"),
        (right, "Lipschitz", "D", "largest |d² impulse / d speed²| [kg s/m]"),
    ]
    for k, (axes, key, marker, label) in enumerate(shown):
        axes.plot(x, curves["measured"][key], marker, color=f"C{k}", label=label)
        axes.plot(x, curves["closed"][key], "-", color=f"C{k}", linewidth=1)
    left.set_title("bias (lines: closed forms)", fontsize="medium")
    right.set_title("Lipschitz constant of the gradient (line: 1 / (4 G^{3/2} √κ))", fontsize="medium")
    for axes in (left, right):
        axes.set(xscale="log", yscale="log", xlabel="κ / (m g h · 1 m/s)")
        axes.grid(alpha=0.25)
        axes.legend(frameon=False, fontsize="small")
    return figure
