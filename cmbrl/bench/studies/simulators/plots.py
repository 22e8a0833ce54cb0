"""Work-precision of trajectories: processor time per simulated second against error, one curve a simulator."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from cmbrl.bench.studies.simulators.measure import Result, Row
from cmbrl.files import atomic_path

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


def plot(results: Sequence[Result], path: str | os.PathLike[str], own: bool) -> None:
    """Writes one panel a scene; ``own``: against the limit of each simulator's own law, else against the truth."""
    columns = min(2, len(results))
    lines = -(-len(results) // columns)
    figure = Figure(figsize=(6.6 * columns, 4.7 * lines + 1.3), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, result in zip(panels, results, strict=False):
        _panel(axes, result, own)
    for axes in panels[len(results) :]:
        axes.remove()
    names = dict.fromkeys(row.engine for result in results for row in result.rows)
    handles = [_handle(name) for name in (n for n in _STYLES if n in names)]
    handles += [_handle(name) for name in names if name not in _STYLES]
    ring = Line2D([], [], ls="", marker="o", mfc="none", mec="k", ms=11, label="the file's own step")
    figure.legend(handles=[*handles, ring], loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130)


def _panel(axes: Axes, result: Result, own: bool) -> None:
    curves: dict[str, list[Row]] = {}
    for row in sorted(result.rows, key=lambda row: -row.step):
        curves.setdefault(row.engine, []).append(row)
    top = 3 * max((_median(row, own) for row in result.rows if not _hidden(row, own)), default=1.0)
    for name, rows in curves.items():
        colour, marker, dash = _STYLES.get(name, _OTHER)
        kept = [row for row in rows if not _hidden(row, own)]
        x, y = [row.seconds for row in kept], [_median(row, own) for row in kept]
        axes.plot(x, y, dash, marker=marker, color=colour, ms=4, lw=1.2)
        for row in kept:
            if np.isclose(row.step, result.file_step):
                axes.plot(row.seconds, _median(row, own), "o", mfc="none", mec=colour, ms=11, mew=1.1)
        for row in rows:
            if row.failed:
                axes.plot(row.seconds, top, marker, color=colour, ms=4, clip_on=False)
                _note(axes, f"{row.failed}", row.seconds, top, (0, 5), colour)
    axes.set(xscale="log", yscale="log", xlabel="processor seconds per simulated second, one core")
    axes.set_ylim(top=top)
    axes.margins(x=0.08)
    axes.xaxis.set_minor_formatter(NullFormatter())
    swept = [rows for name, rows in curves.items() if "kappa" not in name]
    by_cost = sorted(swept, key=lambda rows: rows[-1].seconds)
    for rows, shift in ((by_cost[0], (-3, -10)), (by_cost[-1], (9, 5))):
        for row in rows:
            if not _hidden(row, own):
                _note(axes, f"{1e3 * row.step:.2g} ms", row.seconds, _median(row, own), shift, "0.35")
    if own:
        floor = max(limit["floor"] for limit in result.limits.values())
        bottom = axes.get_ylim()[0]
        if floor > bottom:  # what the references themselves are off by
            axes.axhspan(bottom, floor, color="0.92", zorder=0)
            axes.set_ylim(bottom=bottom)
        truth = "the limit of its own law"
    else:
        truth = "the closed form" if result.truth == "closed form" else f"{result.truth}'s limit"
    lost = any(row.failed for row in result.rows)
    title = f"{result.label}: {result.horizon:.2g} s from {result.states} states"
    axes.set_title(title + ("; at the top edge: trajectories lost" if lost else ""), fontsize="medium", pad=14)
    axes.set_ylabel(f"error to {truth}, relative to the motion", fontsize="small")
    axes.grid(alpha=0.25)


def _median(row: Row, own: bool) -> float:
    value = (row.own if own else row.truth)[1]
    return np.inf if value is None else value


def _hidden(row: Row, own: bool) -> bool:
    return not np.isfinite(_median(row, own))


def _note(axes: Axes, text: str, x: float, y: float, shift: tuple[int, int], colour: str) -> None:
    axes.annotate(
        text, (x, y), shift, textcoords="offset points", ha="center", fontsize=6, color=colour, annotation_clip=False
    )


def _handle(name: str) -> Line2D:
    colour, marker, dash = _STYLES.get(name, _OTHER)
    return Line2D([], [], color=colour, marker=marker, ls=dash, ms=4, lw=1.2, label=name.replace("0.0001", "1e-4"))
