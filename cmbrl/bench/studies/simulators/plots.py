"""Work-precision of trajectories: processor time per simulated second against error, one curve a simulator."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.simulators.cells import Result, Row

_STYLES = {
    "ours, MuJoCo's softness, semi-implicit": ("#6baed6", "o", "-"),
    "ours, MuJoCo's softness, leapfrog": ("#084594", "s", "-"),
    "ours, MuJoCo's softness, midpoint": ("#810f7c", "X", "-"),
    "ours, MuJoCo's softness, leapfrog, kappa 0.0001 J": ("#4292c6", "D", ":"),
    "ours, rigid, semi-implicit": ("#74c476", "o", "-"),
    "ours, rigid, leapfrog": ("#006d2c", "^", "-"),
    "ours, spring-damper, leapfrog": ("#54278f", "v", "-"),
    "MuJoCo, euler": ("#fdae6b", "o", "--"),
    "MuJoCo, rk4": ("#d94801", "s", "--"),
    "MuJoCo, implicit": ("#a63603", "x", "--"),
    "MuJoCo, implicitfast": ("#fd8d3c", "+", "--"),
    "MuJoCo, discrete": ("#e7298a", "*", "--"),
    "MJX, euler": ("#737373", "P", "-."),
    "pymunk": ("#000000", "p", "-."),
}
_OTHER = ("0.5", ".", "-")


def plot(results: Sequence[Result], own: bool) -> Figure:
    """One panel a scene; ``own``: against the limit of each simulator's own law, else against the truth."""
    columns = min(2, len(results))
    rows = -(-len(results) // columns)
    figure, grid = panels(rows, columns, 6.6 * columns, 4.7 * rows + 1.3)
    for axes, result in zip(grid.ravel(), results, strict=False):
        _panel(axes, result, own)
    for axes in grid.ravel()[len(results) :]:
        axes.remove()
    names = dict.fromkeys(row.engine for result in results for row in result.rows)
    handles = [_handle(name) for name in sorted(names, key=[*_STYLES, *names].index)]
    ring = Line2D([], [], ls="", marker="o", mfc="none", mec="k", ms=11, label="the file's own step")
    legend_below(figure, ncols=3, handles=[*handles, ring])
    return figure


def _panel(axes: Axes, result: Result, own: bool) -> None:
    by_name = sorted(result.rows, key=lambda row: (row.engine, -row.step))
    curves = {name: list(rows) for name, rows in groupby(by_name, key=lambda row: row.engine)}
    top = 3 * max((_median(row, own) for row in result.rows if _median(row, own) < np.inf), default=1.0)
    for name, rows in curves.items():
        colour, marker, dash = _STYLES.get(name, _OTHER)
        x, y = [row.seconds for row in rows], np.array([_median(row, own) for row in rows])
        shown = np.isfinite(y)
        axes.plot(np.array(x)[shown], y[shown], dash, marker=marker, color=colour, ms=4, lw=1.2)
        for row in rows:
            if np.isclose(row.step, result.file_step):
                axes.plot(row.seconds, _median(row, own), "o", mfc="none", mec=colour, ms=11, mew=1.1)
            if row.failed:
                axes.plot(row.seconds, top, marker, color=colour, ms=4, clip_on=False)
                _note(axes, f"{row.failed}", row.seconds, top, (0, 5), colour)
    axes.set(xscale="log", yscale="log", xlabel="processor seconds per simulated second, one core")
    axes.set_ylim(top=top)
    axes.margins(x=0.08)
    axes.xaxis.set_minor_formatter(NullFormatter())
    _label_steps(axes, [rows for name, rows in curves.items() if "kappa" not in name], own)
    if own:
        _grey(axes, max(limit["floor"] for limit in result.limits.values()))
    against = {"own": "the limit of its own law", "closed form": "the closed form"}
    truth = against.get("own" if own else result.truth, f"{result.truth}'s limit")
    lost = "; at the top edge: trajectories lost" if any(row.failed for row in result.rows) else ""
    title = f"{result.label}: {result.horizon:.2g} s from {result.states} states{lost}"
    axes.set_title(title, fontsize="medium", pad=14)
    axes.set_ylabel(f"error to {truth}, relative to the motion", fontsize="small")
    axes.grid(alpha=0.25)


def _label_steps(axes: Axes, curves: list[list[Row]], own: bool) -> None:
    """Writes the steps at the points of the cheapest and of the dearest curve."""
    by_cost = sorted(curves, key=lambda rows: rows[-1].seconds)
    for rows, shift in ((by_cost[0], (-3, -10)), (by_cost[-1], (9, 5))):
        for row in rows:
            if np.isfinite(_median(row, own)):
                _note(axes, f"{1e3 * row.step:.2g} ms", row.seconds, _median(row, own), shift, "0.35")


def _grey(axes: Axes, floor: float) -> None:
    """What the references themselves are off by."""
    bottom = axes.get_ylim()[0]
    if floor > bottom:
        axes.axhspan(bottom, floor, color="0.92", zorder=0)
        axes.set_ylim(bottom=bottom)


def _median(row: Row, own: bool) -> float:
    value = (row.own if own else row.truth)[1]
    return np.inf if value is None else value


def _note(axes: Axes, text: str, x: float, y: float, shift: tuple[int, int], colour: str) -> None:
    axes.annotate(
        text, (x, y), shift, textcoords="offset points", ha="center", fontsize=6, color=colour, annotation_clip=False
    )


def _handle(name: str) -> Line2D:
    colour, marker, dash = _STYLES.get(name, _OTHER)
    return Line2D([], [], color=colour, marker=marker, ls=dash, ms=4, lw=1.2, label=name.replace("0.0001", "1e-4"))
