"""Pictures of the comparison on a known scene; an estimator has one colour in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import SymmetricalLogLocator

from cmbrl.bench.studies.estimators.arms import ARMS
from cmbrl.files import atomic_path

_RATIOS = (-10, -2, 0, 1, 2, 5, 10, 100)


def curves(outcomes: Sequence[dict[str, Any]], tasks: Sequence[str], names: Sequence[str], path: Path) -> None:
    """Return against model steps (log) and against seconds, one row a task; all seeds, medians at equal marks."""
    figure = Canvas(figsize=(12, 4.3 * len(tasks) + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(tasks), 2, squeeze=False, sharey="row")
    for row, task in zip(panels, tasks, strict=True):
        for name in names:
            runs = [o for o in outcomes if o["task"] == task and o["contender"] == name]
            for axes, key in zip(row, ("steps", "seconds"), strict=True):
                _lines(axes, runs, key, name)
        row[0].set(xscale="log", xlabel="model steps", ylabel=f"{task}: return of an episode, no noise")
        row[1].set(xlabel="seconds of processor time")
        for axes in row:
            axes.grid(alpha=0.3)
    handles = {line.get_label(): line for line in panels[0, 1].get_lines() if not line.get_label().startswith("_")}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6, frameon=False)
    _save(figure, path)


def _lines(axes: Axes, runs: Sequence[dict[str, Any]], key: str, name: str) -> None:
    style = ARMS[name]
    marks = []
    for run in runs:
        marks.append([(m[key], m["return"]) for m in run["curve"]])
        x, y = np.array(marks[-1]).T
        shown = slice(1 if key == "steps" else 0, None)  # no step has been taken at the first mark
        axes.plot(x[shown], y[shown], style.dash, color=style.colour, lw=0.6, alpha=0.5)
        if run["diverged"]:
            axes.plot(x[-1], y[-1], "x", color=style.colour, ms=8)
    whole = [m for m in marks if len(m) == max(map(len, marks))]
    if whole:
        x, y = np.median(np.array(whole), axis=0)[1 if key == "steps" else 0 :].T
        axes.plot(x, y, style.dash, color=style.colour, lw=2, marker="o", ms=3, label=name)


def qualities(probes: dict[str, dict[str, dict[str, Any]]], path: Path) -> None:
    """Noise, slopes claimed and true, and their ratio, of every estimator at one policy; one row a task."""
    figure = Canvas(figsize=(12, 3.6 * len(probes)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(probes), 3, squeeze=False, sharey="row")
    for row, (task, found) in zip(panels, probes.items(), strict=True):
        for k, (name, f) in enumerate(found.items()):
            colour = ARMS[name].colour
            if f["noise"] is not None:
                row[0].plot(f["noise"], k, "o", color=colour)
            if f["claimed"] is None or f["true"] is None:
                continue
            for key, fill, off in (("claimed", "white", -0.12), ("true", colour, 0.12)):
                row[1].errorbar(f[key], k + off, xerr=2 * (f[f"{key}_error"] or 0.0), fmt="o", color=colour, mfc=fill,
                                capsize=3)  # fmt: skip
            row[2].plot(f["claimed"] / f["true"], k, "o", color=colour)
        row[0].set_yticks(range(len(found)), list(found))
        row[0].invert_yaxis()
        row[0].set(xlim=(0, None), xlabel="noise: standard error / norm", title=task)
        row[0].axvline(1.0, color="0.5", ls=":")
        row[1].set(xlabel="slope along the estimate: claimed (open), true (full)")
        least = _least(found)
        row[1].set_xscale("symlog", linthresh=least)
        row[1].xaxis.set_major_locator(SymmetricalLogLocator(base=100, linthresh=least))
        row[2].set(xlabel="claimed / true")
        row[2].set_xscale("symlog", linthresh=2.0)
        row[2].set_xticks(_RATIOS, [f"{x:g}" for x in _RATIOS])
        row[2].axvline(1.0, color="0.5", ls=":")
        for axes in row[1:]:
            axes.axvline(0.0, color="0.5", lw=0.8)
        for axes in row:
            axes.grid(alpha=0.3)
    _save(figure, path)


def _least(found: dict[str, dict[str, Any]]) -> float:
    """Where the axis of slopes turns linear: above the errors of true ones, below which signs mean little."""
    return 100.0 ** np.ceil(np.log10(max([f["true_error"] or 0.0 for f in found.values()] + [1e-9])) / 2)


def _save(figure: Canvas, path: Path) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130)
