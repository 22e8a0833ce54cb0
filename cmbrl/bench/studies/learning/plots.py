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
from cmbrl.bench.studies.learning.tables import STEPS, Groups, costs, errors

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
Panel = Callable[[Axes, Groups, int], None]


def grid(groups: Groups, panel: Panel, horizons: Sequence[int]) -> Figure:
    """A row of ``horizons`` for every task, one legend below."""
    tasks = list(dict.fromkeys(task for task, _, _ in groups))
    figure, rows = panels(len(tasks), len(horizons), max(8.6, 4.3 * len(horizons)), 3.3 * len(tasks) + 1.1)
    for task, line in zip(tasks, rows, strict=True):
        mine = {key: cells for key, cells in groups.items() if key[0] == task}
        for horizon, axes in zip(horizons, line, strict=True):
            axes.set(yscale="log", ylim=(LOW, HIGH))
            panel(axes, mine, horizon)
            axes.set_title(f"{task}, {STEPS[HORIZONS.index(horizon)]}", fontsize="medium")
            scale = "change" if horizon == 1 else "state"
            axes.set_ylabel(f"RMSE / standard deviation of the {scale}", fontsize="small")
            axes.tick_params(labelsize="small")
            axes.grid(alpha=0.25)
    models = {model for _, model, _ in groups}
    styles = [(model, *style) for model, style in STYLES.items() if model in models]
    handles = [Line2D([], [], color=colour, marker=marker, label=model, ms=5) for model, colour, marker in styles]
    legend_below(figure, [], 4 if len(horizons) > 1 else 3, handles)
    return figure


def _inside(values: Any) -> np.ndarray:
    return np.clip(values, LOW * 1.04, HIGH / 1.04)


def _learning(axes: Axes, groups: Groups, horizon: int, at: Callable[[int, Any], np.ndarray], growing: bool) -> None:
    """A mark a seed at ``at(rows, cells)`` and lines through medians; dashed: models that learn nothing.

    Errors outside the axes sit on the edge as triangles that point outwards. growing: marks grow with the log.
    """
    paths: dict[str, list[tuple[float, float]]] = {}
    for (_, model, rows), cells in groups.items():
        (colour, marker), y = STYLES[model], errors(cells, horizon)
        if len(y) and rows == 0:
            axes.axhline(float(_inside(y[0])), color=colour, lw=1, ls=(0, (4, 2)))
        elif len(y):
            x, size = at(rows, cells)[: len(y)], 18 * np.log10(rows / 10) if growing else 30
            places: dict[Any, np.ndarray] = {marker: (y >= LOW) & (y <= HIGH), 6: y > HIGH, 7: y < LOW}
            for shape, mask in places.items():
                axes.scatter(x[mask], _inside(y[mask]), size, colour, marker=shape, alpha=0.6, linewidths=0)
            paths.setdefault(model, []).append((float(np.median(x)), float(_inside(np.median(y)))))
    for model, path in paths.items():
        axes.plot(*np.array(path).T, color=STYLES[model][0], lw=1.2)


def against_transitions(axes: Axes, groups: Groups, horizon: int) -> None:
    """Error over the size of the log."""
    _learning(axes, groups, horizon, lambda rows, cells: np.full(len(cells), float(rows)), growing=False)
    axes.set(xscale="log", xlabel="transitions")
    learnt = sorted({rows for _, _, rows in groups if rows})
    if learnt:
        axes.set_xlim(min(learnt) / 1.5, max(learnt) * 1.5)
        axes.set_xticks(learnt, [f"{n:,}" for n in learnt])
        axes.minorticks_off()


def against_fit_time(axes: Axes, groups: Groups, horizon: int) -> None:
    """Error over fit time."""
    _learning(axes, groups, horizon, lambda rows, cells: costs(cells, "fit_seconds"), growing=True)
    axes.set(xscale="log", xlabel="fit time, processor s (larger mark: more data)")


def against_prediction_time(axes: Axes, groups: Groups, horizon: int) -> None:
    """Every model at its largest log: in batches (filled), one state at a time (hollow)."""
    largest = {model: cells for (_, model, _), cells in groups.items()}  # sizes ascend
    for model, cells in largest.items():
        (colour, marker), found = STYLES[model], errors(cells, horizon)
        if not len(found):
            continue
        y = float(_inside(np.median(found)))
        ends = [float(np.median(costs(cells, key))) for key in ("batch", "alone")]
        axes.plot(ends, [y, y], color=colour, lw=0.8, alpha=0.6)
        for x, face in zip(ends, (colour, "white"), strict=True):
            axes.scatter(x, y, 40 if marker == "." else 26, face, marker=marker, edgecolors=colour, zorder=3)
    axes.set(xscale="log")
    axes.set_xlabel("microseconds per transition (filled: in batches, hollow: alone)", fontsize="small")


def strata(axes: Axes, groups: Groups, horizon: int) -> None:
    """Bars at the size that most models were trained on; whiskers from the best to the worst seed."""
    common = common_rows(groups)
    models = {model: cells for (_, model, rows), cells in groups.items() if rows in (0, common)}
    width = 0.85 / max(1, len(models))
    names: list[str] = []
    for stratum in ("flight", "contact"):
        columns = {model: errors(cells, horizon, stratum) for model, cells in models.items()}
        if not any(len(found) for found in columns.values()):
            continue  # no window of so many steps without contact
        for k, (model, found) in enumerate(columns.items()):
            y, low, high = _inside([np.median(found), found.min(), found.max()])
            x = len(names) + (k + 0.5) * width - 0.425
            axes.bar(x, y, width, color=STYLES[model][0], yerr=[[y - low], [high - y]], error_kw={"lw": 0.7})
        names.append(stratum)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlabel(f"trained on {common:,} transitions")


def common_rows(groups: Groups) -> int:
    """The size that most models were trained on, the largest of them; 0 before any was."""
    trained = [rows for _, _, rows in groups if rows]
    return max(set(trained), key=lambda rows: (trained.count(rows), rows), default=0)


PICTURES: dict[str, tuple[Panel, Sequence[int]]] = {
    "transitions.png": (against_transitions, HORIZONS),
    "fit_time.png": (against_fit_time, HORIZONS),
    "prediction_time.png": (against_prediction_time, HORIZONS),
    "strata.png": (strata, (1,)),
}
