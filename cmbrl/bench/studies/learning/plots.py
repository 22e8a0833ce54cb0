"""The pictures of the learning study: one panel per task and horizon, one colour and mark per model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.learning.cells import HORIZONS
from cmbrl.bench.studies.learning.results import STEPS, Results

STYLES: dict[str, tuple[str, str]] = {
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
Panel = Callable[[Axes, Results, str, int], None]


def grid(results: Results, panel: Panel, horizons: Sequence[int]) -> Figure:
    """A row of ``horizons`` for every task, one legend below."""
    figure, rows = panels(
        len(results.tasks), len(horizons), max(8.6, 4.3 * len(horizons)), 3.3 * len(results.tasks) + 1.1
    )
    for task, line in zip(results.tasks, rows, strict=True):
        for horizon, axes in zip(horizons, line, strict=True):
            axes.set(yscale="log", ylim=(LOW, HIGH))
            panel(axes, results, task, horizon)
            axes.set_title(f"{task}, {STEPS[HORIZONS.index(horizon)]}", fontsize="medium")
            scale = "change" if horizon == 1 else "state"
            axes.set_ylabel(f"RMSE / standard deviation of the {scale}", fontsize="small")
            axes.tick_params(labelsize="small")
            axes.grid(alpha=0.25)
    styles = [(model, *STYLES[model]) for model in STYLES if model in results.models]
    handles = [Line2D([], [], color=colour, marker=marker, label=model, ms=5) for model, colour, marker in styles]
    legend_below(figure, [], 4 if len(horizons) > 1 else 3, handles)
    return figure


def _inside(errors: Any) -> np.ndarray:
    return np.clip(errors, LOW * 1.04, HIGH / 1.04)


def _learning(
    axes: Axes, results: Results, task: str, horizon: int,
    at: Callable[[str, int, int], np.ndarray], size: Callable[[int], float],
) -> None:  # fmt: skip
    """A mark a seed at ``at(model, rows, seeds)`` and a line through medians; dashed: a model that learns nothing.

    Errors outside the axes sit on the edge as triangles that point outwards.
    """
    for model in results.models:
        colour, marker = STYLES[model]
        path = []
        for rows in results.sizes(task, model):
            errors = results.errors(task, model, rows, horizon)
            if not len(errors):
                continue
            if rows == 0:
                axes.axhline(float(_inside(errors[0])), color=colour, lw=1, ls=(0, (4, 2)))
                continue
            x = at(model, rows, len(errors))
            places: dict[Any, np.ndarray] = {
                marker: (errors >= LOW) & (errors <= HIGH),
                6: errors > HIGH,
                7: errors < LOW,
            }
            for shape, mask in places.items():
                axes.scatter(x[mask], _inside(errors[mask]), size(rows), colour, marker=shape, alpha=0.6, linewidths=0)
            path.append((np.median(x), _inside(np.median(errors))))
        if path:
            axes.plot(*np.array(path).T, color=colour, lw=1.2)


def against_transitions(axes: Axes, results: Results, task: str, horizon: int) -> None:
    """Error over the size of the log."""
    _learning(axes, results, task, horizon, lambda model, rows, seeds: np.full(seeds, float(rows)), lambda rows: 30)
    axes.set(xscale="log", xlabel="transitions")
    learnt = sorted({n for model in results.models for n in results.sizes(task, model) if n})
    if learnt:
        axes.set_xlim(min(learnt) / 1.5, max(learnt) * 1.5)
        axes.set_xticks(learnt, [f"{n:,}" for n in learnt])
        axes.minorticks_off()


def against_fit_time(axes: Axes, results: Results, task: str, horizon: int) -> None:
    """Error over fit time; marks grow with the log."""

    def seconds(model: str, rows: int, seeds: int) -> np.ndarray:
        return results.cost(task, model, rows, "fit_seconds")[:seeds]

    _learning(axes, results, task, horizon, seconds, lambda rows: 18 * np.log10(rows / 10))
    axes.set(xscale="log", xlabel="fit time, processor s (larger mark: more data)")


def against_prediction_time(axes: Axes, results: Results, task: str, horizon: int) -> None:
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
        for x, face in zip(ends, (colour, "white"), strict=True):
            axes.scatter(x, y, 40 if marker == "." else 26, face, marker=marker, edgecolors=colour, zorder=3)
    axes.set(xscale="log")
    axes.set_xlabel("microseconds per transition (filled: in batches, hollow: alone)", fontsize="small")


def strata(axes: Axes, results: Results, task: str, horizon: int) -> None:
    """Bars at the size that most models were trained on; whiskers from the best to the worst seed."""
    common = results.common_rows()
    sizes = {m: 0 if results.sizes(task, m) == [0] else common for m in results.models}
    models = [m for m, rows in sizes.items() if rows in results.sizes(task, m)]
    width = 0.85 / max(1, len(models))
    found: list[str] = []
    for stratum in ("flight", "contact"):
        columns = [results.errors(task, m, sizes[m], horizon, stratum) for m in models]
        if not any(len(c) for c in columns):
            continue  # no window of so many steps without contact
        for k, (model, errors) in enumerate(zip(models, columns, strict=True)):
            y, low, high = _inside([np.median(errors), errors.min(), errors.max()])
            x = len(found) + (k + 0.5) * width - 0.425
            axes.bar(x, y, width, color=STYLES[model][0], yerr=[[y - low], [high - y]], error_kw={"lw": 0.7})
        found.append(stratum)
    axes.set_xticks(range(len(found)), found)
    axes.set_xlabel(f"trained on {common:,} transitions")


PICTURES: dict[str, tuple[Panel, Sequence[int]]] = {
    "transitions.png": (against_transitions, HORIZONS),
    "fit_time.png": (against_fit_time, HORIZONS),
    "prediction_time.png": (against_prediction_time, HORIZONS),
    "strata.png": (strata, (1,)),
}
