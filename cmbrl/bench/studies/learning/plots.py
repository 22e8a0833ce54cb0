"""The pictures of the learning study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle

from cmbrl.bench.studies.learning.cells import HORIZONS
from cmbrl.bench.studies.learning.results import Results, middle
from cmbrl.files import atomic_path

STYLES = {
    "hold": ("0.6", "."),
    "wrong MJCF": ("0.35", "."),
    "true MJCF": ("black", "."),
    "fitted, all parameters": ("#08519c", "o"),
    "fitted, parsimonious": ("#4292c6", "s"),
    "mujoco.sysid, true integrator": ("#54278f", "P"),
    "mujoco.sysid, other integrator": ("#9e9ac8", "X"),
    "Gaussian process": ("#238b45", "D"),
    "ensemble (MBPO)": ("#fdae6b", "v"),
    "ensemble (MBPO), targets normalised": ("#f16913", "^"),
    "ensemble, tuned": ("#cb181d", "<"),
    "ensemble, tuned and larger": ("#67000d", ">"),
}
LOW, HIGH = 0.01, 20.0  # errors outside are drawn on the edge
LABELS = {1: "RMSE / std of the change", 20: "RMSE / std of the state", 100: "RMSE / std of the state"}
Panel = Callable[[Axes, Results, str, int], None]


def draw(results: Results, folder: Path) -> dict[str, str]:
    """Writes every picture into ``folder``; file -> what it is called."""
    _grid(results, folder / "transitions.png", _against_transitions, HORIZONS)
    _grid(results, folder / "fit_time.png", _against_fit_time, HORIZONS)
    _grid(results, folder / "prediction_time.png", _against_prediction_time, HORIZONS)
    _grid(results, folder / "strata.png", _strata, (1,))
    return {
        "transitions.png": "Error against transitions",
        "fit_time.png": "Error against fit time",
        "prediction_time.png": "Error against prediction time",
        "strata.png": "Error in flight and in contact",
    }


def _grid(results: Results, path: Path, panel: Panel, horizons: Sequence[int]) -> None:
    """One panel per task and horizon, one legend below."""
    figure = Figure(figsize=(max(8.6, 4.3 * len(horizons)), 3.3 * len(results.tasks) + 1.1), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(results.tasks), len(horizons), squeeze=False)
    for task, line in zip(results.tasks, grid, strict=True):
        for horizon, axes in zip(horizons, line, strict=True):
            panel(axes, results, task, horizon)
            axes.set_title(f"{task}, {horizon} step{'s' * (horizon > 1)}", fontsize="medium")
            axes.set_ylabel(LABELS[horizon], fontsize="small")
            axes.tick_params(labelsize="small")
            axes.grid(alpha=0.25)
    handles = [
        Line2D([], [], color=colour, marker=marker, label=model, markersize=5)
        for model, (colour, marker) in STYLES.items()
        if model in results.models
    ]
    columns = 4 if len(horizons) > 1 else 3
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def _inside(errors: np.ndarray) -> np.ndarray:
    return np.clip(errors, LOW * 1.04, HIGH / 1.04)


def _points(axes: Axes, x: np.ndarray, errors: np.ndarray, colour: str, marker: str, size: float) -> None:
    """Errors (n,) at x (n,); those outside the axes sit on the edge as triangles that point outwards."""
    places: tuple[tuple[np.ndarray, Any], ...] = (
        ((errors >= LOW) & (errors <= HIGH), marker),
        (errors > HIGH, 6),
        (errors < LOW, 7),
    )
    for mask, shape in places:
        if mask.any():
            axes.scatter(
                x[mask], _inside(errors[mask]), size, colour, marker=MarkerStyle(shape), alpha=0.6, linewidths=0
            )


def _against_transitions(axes: Axes, results: Results, task: str, horizon: int) -> None:
    learnt = [n for m in results.models for n in results.sizes(task, m) if n]
    for model in results.models:
        colour, marker = STYLES[model]
        sizes = results.sizes(task, model)
        columns = [results.errors(task, model, n, horizon) for n in sizes]
        if not any(len(c) for c in columns):
            continue
        if not results.learns(task, model):
            axes.axhline(float(_inside(columns[0])[0]), color=colour, lw=1, ls=(0, (4, 2)))
            continue
        known = [(n, middle(c)) for n, c in zip(sizes, columns, strict=True) if len(c)]
        axes.plot([n for n, _ in known], _inside(np.array([e for _, e in known])), color=colour, lw=1.3)
        for n, errors in zip(sizes, columns, strict=True):
            _points(axes, np.full(len(errors), float(n)), errors, colour, marker, 30)
    axes.set(xscale="log", yscale="log", ylim=(LOW, HIGH), xlabel="transitions")
    if learnt:
        axes.set_xlim(min(learnt) / 1.5, max(learnt) * 1.5)
        axes.set_xticks(sorted(set(learnt)), [f"{n:,}" for n in sorted(set(learnt))])
        axes.minorticks_off()


def _against_fit_time(axes: Axes, results: Results, task: str, horizon: int) -> None:
    """Marks grow with the log: 200 to 100,000 transitions."""
    for model in results.models:
        colour, marker = STYLES[model]
        if not results.learns(task, model):
            untrained = results.errors(task, model, 0, horizon)
            if len(untrained):
                axes.axhline(float(_inside(untrained)[0]), color=colour, lw=1, ls=(0, (4, 2)))
            continue
        path = []
        for rows in results.sizes(task, model):
            errors = results.errors(task, model, rows, horizon)
            seconds = results.cost(task, model, rows, "fit_seconds")[: len(errors)]
            if len(errors):
                _points(axes, seconds, errors, colour, marker, 18 * np.log10(rows / 10))
                path.append((float(np.median(seconds)), float(np.median(errors))))
        if path:
            x, y = np.array(path).T
            axes.plot(x, _inside(y), color=colour, lw=1)
    axes.set(xscale="log", yscale="log", ylim=(LOW, HIGH), xlabel="fit time, processor s (larger mark: more data)")


def _against_prediction_time(axes: Axes, results: Results, task: str, horizon: int) -> None:
    """Every model at its largest log: in batches (filled), one state at a time (hollow)."""
    for model in results.models:
        colour, marker = STYLES[model]
        rows = max(results.sizes(task, model), default=None)
        errors = np.array([]) if rows is None else results.errors(task, model, rows, horizon)
        if rows is None or not len(errors):
            continue
        y = float(_inside(np.median(errors)))
        ends = [float(np.median(results.cost(task, model, rows, key))) for key in ("batch", "alone")]
        axes.plot(ends, [y, y], color=colour, lw=0.8, alpha=0.6)
        size = 40 if marker == "." else 26
        axes.scatter(ends[0], y, size, colour, marker=marker, zorder=3)
        axes.scatter(ends[1], y, size, "white", marker=marker, edgecolors=colour, linewidths=1, zorder=3)
    axes.set(xscale="log", yscale="log", ylim=(LOW, HIGH))
    axes.set_xlabel("us per transition (filled: in batches, hollow: alone)", fontsize="small")


def _strata(axes: Axes, results: Results, task: str, horizon: int) -> None:
    """Bars at the size that most models were trained on; whiskers from the best to the worst seed."""
    rows = common_rows(results)
    models = [m for m in results.models if rows in results.sizes(task, m) or not results.learns(task, m)]
    width = 0.85 / max(1, len(models))
    found: list[str] = []
    for stratum in ("flight", "contact"):
        columns = [results.errors(task, m, rows if results.learns(task, m) else 0, horizon, stratum) for m in models]
        if not any(len(c) for c in columns):
            continue  # no window of so many steps without contact
        for k, (model, errors) in enumerate(zip(models, columns, strict=True)):
            y, low, high = _inside(np.array([np.median(errors), errors.min(), errors.max()]))
            x = len(found) + (k + 0.5) * width - 0.425
            axes.bar(x, y, width, color=STYLES[model][0], yerr=[[y - low], [high - y]], error_kw={"lw": 0.7})
        found.append(stratum)
    axes.set_xticks(range(len(found)), found)
    axes.set(yscale="log", ylim=(LOW, HIGH), xlabel=f"trained on {rows:,} transitions")


def common_rows(results: Results) -> int:
    """The size that most models were trained on, the largest of them; 0 before any was."""
    trained = [n for t in results.tasks for m in results.models for n in results.sizes(t, m) if n]
    return max(set(trained), key=lambda n: (trained.count(n), n), default=0)
