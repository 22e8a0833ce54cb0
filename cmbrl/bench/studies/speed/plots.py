"""The picture of a speed table: microseconds per physics step by scene, MuJoCo's beside ours."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.files import atomic_path

if TYPE_CHECKING:
    from cmbrl.bench.studies.speed.table import SpeedTable

_BARS = (
    ("mjd_transitionFD", "MuJoCo: step and Jacobian by differences", "0.75"),
    ("mj_step", "MuJoCo: mj_step", "0.45"),
    ("forward", "ours: step", "#9ecae1"),
    ("vjp", "ours: step and vector-Jacobian product", "#4292c6"),
    ("jacobian", "ours: step and full Jacobian", "#084594"),
)


def plot(table: SpeedTable, path: str | os.PathLike[str], smoothing: str = "1e-4 J") -> None:
    """Writes the figure of the rows at ``smoothing`` to ``path``; its suffix is the format.

    Built without pyplot, so that nothing of the caller's matplotlib state is touched. Whiskers: lowest and highest
    repeat.
    """
    rows = [row for row in table.rows if row.smoothing == smoothing]
    figure = Figure(figsize=(max(8.5, 1.5 * len(rows) + 2), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    width = 0.85 / len(_BARS)
    for k, (kind, label, colour) in enumerate(_BARS):
        at = np.array([i for i, row in enumerate(rows) if kind in row.seconds])
        spreads = [row.seconds[kind] for row in rows if kind in row.seconds]
        if not spreads:
            continue
        heights = 1e6 * np.array([s.median for s in spreads])
        whiskers = np.abs(1e6 * np.array([[s.low for s in spreads], [s.high for s in spreads]]) - heights)
        place = at + (k - (len(_BARS) - 1) / 2) * width
        axes.bar(place, heights, width, yerr=whiskers, label=label, color=colour, error_kw={"lw": 0.6})
        for x, height in zip(place, heights, strict=True):
            number = f"{height:.2g}" if height < 100 else f"{height:.0f}"
            axes.annotate(number, (x, height), (0, 3), textcoords="offset points", ha="center", fontsize=6)
    axes.set_xticks(range(len(rows)), [f"{row.scene}\n{row.contacts:.1f} contacts" for row in rows], fontsize="small")
    axes.set(yscale="log", ylabel="us per physics step, one core")
    axes.set_title(f"batch {table.batch}, kappa {smoothing}, {table.isa}", fontsize="medium")
    axes.grid(alpha=0.3, axis="y")
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)
