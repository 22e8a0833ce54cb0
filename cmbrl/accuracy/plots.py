"""The figure of an error table: growth of errors with the horizon, and errors by stratum."""

from __future__ import annotations

import os

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.accuracy.open_loop import OpenLoop
from cmbrl.accuracy.table import ErrorTable
from cmbrl.files import atomic_path


def plot(table: ErrorTable, path: str | os.PathLike[str]) -> None:
    """Writes the figure of ``table`` to ``path``, in the format of its suffix.

    Does not use pyplot, so the caller's matplotlib state does not change.
    """
    shown = [h for h in table.horizons if h.steps == 1] or table.horizons[:1]
    longest = table.horizons[-1]
    if longest.steps != shown[0].steps:
        shown.append(longest)
    figure = Figure(figsize=(4.5 * (1 + len(shown)), 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 1 + len(shown), squeeze=False)[0]
    _curves(axes[0], table)
    for panel, horizon in zip(axes[1:], shown, strict=True):
        _bars(panel, table, horizon.steps)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=max(1, len(labels)), frameon=False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def plot_open_loop(found: OpenLoop, path: str | os.PathLike[str]) -> None:
    """Writes drift against time, mean over coordinates, in the format of the suffix of ``path``."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for name, error in found.errors.items():
        axes.plot(found.time, 1e3 * np.abs(error).mean(axis=1), label=name, linewidth=0.8)
    axes.axvspan(found.since, found.time.max(), color="0.92", label="judged")
    axes.set(xlabel="time [s]", ylabel="mean absolute error [mrad, mm]", ylim=(0.0, None))
    figure.legend(loc="outside lower center", ncols=1 + len(found.errors), frameon=False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def _curves(axes: Axes, table: ErrorTable) -> None:
    """One curve per model, over the steps of the longest windows."""
    for name, errors in table.curves.items():
        axes.plot(np.arange(1, len(errors) + 1), errors, label=name, marker="." if len(errors) < 30 else None)
    axes.set(xscale="log", yscale="log", xlabel="steps predicted open loop", ylabel="RMSE / std of the state")
    windows = table.horizons[-1].windows["all"]
    axes.set_title(f"error against horizon ({windows} windows)", fontsize="medium")
    axes.grid(alpha=0.3)


def _bars(axes: Axes, table: ErrorTable, steps: int) -> None:
    """A group of bars per stratum, a bar per model."""
    strata = next(h.windows for h in table.horizons if h.steps == steps)
    width = 0.8 / len(table.models)
    for k, model in enumerate(table.models):
        errors = [table.entry(model, steps, stratum).error for stratum in strata]
        heights = [e if np.isfinite(e) else np.nan for e in errors]  # a diverged model has no bar
        axes.bar(np.arange(len(strata)) + (k + 0.5) * width - 0.4, heights, width)
    labels = [f"{stratum}\n({windows})".replace(", ", ",\n") for stratum, windows in strata.items()]
    axes.set_xticks(np.arange(len(strata)), labels, fontsize="small")
    unit = "change" if steps == 1 else "state"
    axes.set(yscale="log", ylabel=f"RMSE / std of the {unit}")
    axes.set_title(f"{steps} step{'s' * (steps > 1)}, by stratum (windows)", fontsize="medium")
    axes.grid(alpha=0.3, axis="y")
