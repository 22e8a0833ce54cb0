"""The picture of the speed study."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.speed.growth import SIZES, exponents

BARS = {
    "mjd_transitionFD": ("MuJoCo: step and Jacobian by differences", "0.75"),
    "mj_step": ("MuJoCo: mj_step", "0.45"),
    "forward": ("ours: step", "#9ecae1"),
    "vjp": ("ours: step and vector-Jacobian product", "#4292c6"),
    "jacobian": ("ours: step and full Jacobian", "#084594"),
}


def bars(values: dict[str, Any], smoothing: str = "1e-4 J") -> Figure:
    """Times by scene at ``smoothing``. Numbers stand above the whiskers, which span the turns."""
    rows = [row for row in values["rows"] if row["smoothing"] == smoothing]
    figure, grid = panels(1, 1, max(8.5, 1.5 * len(rows) + 2), 4.2)
    axes, width = grid[0, 0], 0.85 / len(BARS)
    for k, (kind, (label, colour)) in enumerate(BARS.items()):
        found = [(i, row["seconds"][kind]) for i, row in enumerate(rows) if kind in row["seconds"]]
        if not found:
            continue
        places = np.array([i for i, _ in found]) + (k - (len(BARS) - 1) / 2) * width
        low, middle, high = 1e6 * np.array([[s[key] for key in ("low", "median", "high")] for _, s in found]).T
        whiskers = [middle - low, high - middle]
        axes.bar(places, middle, width, yerr=whiskers, label=label, color=colour, error_kw={"lw": 0.6})
        for x, time, top in zip(places, middle, high, strict=True):
            number = f"{time:.2g}" if time < 100 else f"{time:.0f}"
            axes.annotate(number, (x, top), (0, 3), textcoords="offset points", ha="center", fontsize=6)
    axes.set_xticks(
        range(len(rows)), [f"{row['scene']}\n{row['contacts']:.1f} contacts" for row in rows], fontsize="small"
    )
    axes.set(yscale="log", ylabel="microseconds per physics step, one core")
    axes.set_title(f"batch {values['batch']}, kappa {smoothing}, {values['isa']}", fontsize="medium")
    axes.grid(alpha=0.3, axis="y")
    legend_below(figure, ncols=3)
    return figure


def curves(rows: list[dict[str, Any]]) -> Figure:
    """Times by size, a panel for each of what grows; the legend has their exponents."""
    wanted = [what for what in SIZES if any(row["what"] == what for row in rows)]
    figure, grid = panels(1, len(wanted), 4.6 * len(wanted), 4.2)
    for axes, what in zip(grid[0], wanted, strict=True):
        these = [row for row in rows if row["what"] == what]
        powers, sizes = exponents(these), [row["size"] for row in these]
        for kind, (label, colour) in BARS.items():
            if kind not in powers:
                continue
            times = [1e6 * row["seconds"][kind]["median"] for row in these]
            axes.loglog(sizes, times, "o-", ms=3, color=colour, label=f"{label} [{powers[kind]:.2f}]")
        axes.set(xlabel=what, ylabel="microseconds per physics step, one core")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=6, frameon=False)
    return figure
