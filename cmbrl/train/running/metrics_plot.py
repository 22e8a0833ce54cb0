"""The picture of a run: return and gradient against steps and against wall-clock time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from cmbrl.files import atomic_path
from cmbrl.train.running.metrics import Row

_REAL, _MODEL = "real transitions", "model steps"


def plot_metrics(rows: list[Row], path: Path, title: str) -> None:
    """Writes the figure to ``path``; its suffix gives the format. Built without pyplot."""
    real = any(row.get("transitions") for row in rows)
    axes_of = {"transitions" if real else "steps": _REAL if real else _MODEL, "seconds": "wall clock [s]"}
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, 2, sharex="col", sharey="row")
    for column, (key, label) in enumerate(axes_of.items()):
        upper, lower = grid[0, column], grid[1, column]
        _curve(upper, rows, key, "return", "tab:blue")
        if not upper.lines:
            upper.text(0.5, 0.5, "no episode has ended", ha="center", transform=upper.transAxes, color="0.4")
        _curve(lower, rows, key, "gradient_norm", "tab:blue", "norm")
        _curve(lower, rows, key, "gradient_variance", "tab:orange", "variance")
        if lower.lines:
            if any((np.asarray(line.get_ydata()) > 0).any() for line in lower.lines):
                lower.set_yscale("log")
            # Not 10^k in mathtext: its parser keeps exceptions, whose frames would keep the run's model alive.
            lower.yaxis.set_major_formatter("{x:g}")
            lower.yaxis.set_minor_formatter(NullFormatter())
        else:
            lower.text(0.5, 0.5, "no gradient is reported", ha="center", transform=lower.transAxes, color="0.4")
        lower.set_xlabel(label)
        for axes in (upper, lower):
            axes.grid(alpha=0.3)
    grid[0, 0].set_ylabel("return of an episode")
    grid[1, 0].set_ylabel("policy gradient")
    if grid[1, 0].lines:
        grid[1, 0].legend(frameon=False, fontsize="small")
    figure.suptitle(title, fontsize="medium")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130)


def _curve(axes: Any, rows: list[Row], x: str, y: str, colour: str, label: str | None = None) -> None:
    points = np.array([(row[x], row[y]) for row in rows if x in row and y in row])
    if len(points) and np.isfinite(points[:, 1]).any():
        marker = "." if len(points) < 40 else ""
        axes.plot(points[:, 0], points[:, 1], color=colour, lw=1.0, marker=marker, label=label)
