"""Pictures of the gradient scenes: bias and mismatch against kappa; estimators across jumps against bundle size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.studies.gradients.case import Array
from cmbrl.files import atomic_path

if TYPE_CHECKING:
    from cmbrl.bench.studies.gradients.scenes import Row

FLOOR = 1e-12  #: smaller errors are drawn here
MARKERS = "osv^D*P"


def plot_bias(rows: Sequence[Row], kappas: Sequence[float], path: Path) -> None:
    """Left the distance to the truth, right to finite differences, against kappa: the worst derivative of each scene.

    Cases whose hard derivative misses the truth have dashed curves of their own.
    """
    figure = Figure(figsize=(12, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    curves: dict[str, list[Row]] = {}
    for row in rows:
        curves.setdefault(f"{row.label} {row.title}" if row.weakness_shows else row.label, []).append(row)
    names = [f"kappa {kappa:.0e}" for kappa in kappas]
    scenes = list(dict.fromkeys(row.label for row in rows))
    for label, held in curves.items():
        k = scenes.index(held[0].label)
        style = {"color": f"C{k % 10}", "marker": MARKERS[k % len(MARKERS)], "ms": 4, "lw": 1.2,
                 "ls": "--" if " " in label else "-", "label": label}  # fmt: skip
        left.plot(kappas, [max(*(r.bias(r.ours[name]) for r in held), FLOOR) for name in names], **style)
        right.plot(kappas, [max(*(r.mismatch(name) for r in held), FLOOR) for name in names], **style)
    left.set(title="bias: |softened - true|", ylabel="relative to the larger of 1 and the derivative")
    right.set(title="mismatch: |ours - finite differences at the same kappa|")
    right.axhline(1e-4, color="0.6", ls=":", lw=1)
    right.annotate("passes below", (kappas[0], 1e-4), (0, 3), textcoords="offset points", fontsize="small", color="0.4")
    for axes in (left, right):
        axes.set(xscale="log", yscale="log", xlabel="kappa [J]", ylim=(FLOOR / 2, None))
        axes.grid(alpha=0.3)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=8, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def plot_jumps(errors: dict[str, dict[str, Array]], sizes: Sequence[int], path: Path) -> None:
    """One panel a scene: rms error of first and zeroth order, and what they report of themselves (dashed)."""
    figure = Figure(figsize=(3.1 * len(errors), 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(errors), squeeze=False, sharey=True)[0]
    for axes, (name, orders) in zip(panels, errors.items(), strict=True):
        for (order, values), colour in zip(orders.items(), ("#d62728", "#1f77b4"), strict=True):
            axes.plot(sizes, values[:, 0], color=colour, marker=".", label=order)
            said = np.where(values[:, 1] > 0, values[:, 1], np.nan)
            axes.plot(sizes, said, color=colour, ls="--", lw=1, label=f"{order}, as reported")
            if np.isnan(said).all():
                axes.annotate(
                    "first order reports 0", (0.05, 0.06), xycoords="axes fraction", fontsize="small", color=colour
                )
        axes.set(xscale="log", yscale="log", xlabel="bundle size")
        axes.set_title(name, fontsize="medium")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("error of the gradient")
    handles, labels = panels[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)
