"""Pictures of the estimators: bias and deviation against smoothing length, horizon and cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.gradients.arms import FAMILIES
from cmbrl.bench.studies.gradients.cells import Quality

Style = tuple[str, str, str]  #: colour, line, marker
STYLES: dict[str, Style] = {
    "exact": ("black", "-", "o"), "barrier": ("#1f77b4", "-", "s"), "adaptive": ("#d62728", "-", "^"),
    "barrier, both": ("#6baed6", "--", "P"), "adaptive, both": ("#fc8d59", "--", "X"),
    "randomised": ("#2ca02c", "-", "D"), "zeroth order": ("#9467bd", "-", "v"),
}  # fmt: skip
SHADES = {
    "barrier": ("#c6dbef", "#6baed6", "#2171b5", "#08306b"),
    "adaptive": ("#fcbba1", "#fb6a4a", "#cb181d", "#67000d"),
}  #: by smoothing length, from short to long
LOW, HIGH = 1e-3, 1e3  #: relative errors are drawn inside these; arrows mark larger ones


def against_length(rows: Sequence[Quality], systems: Sequence[str], horizon: int) -> Figure:
    """Two rows of panels, bias above and deviation below, one column a system."""
    figure, grid = _grid(systems, f"horizon of {horizon} control steps")
    for column, system in enumerate(systems):
        for family, style in STYLES.items():
            points = _largest([r for r in rows if (r.system, r.horizon, r.family) == (system, horizon, family)])
            _draw(grid[:, column], style, points, [r.length or np.nan for r in points])
        grid[1, column].set_xlabel("smoothing length [m]\n(zeroth order: deviation of parameters)", fontsize="small")
    _finish(grid)
    _families(figure)
    return figure


def against_horizon(rows: Sequence[Quality], systems: Sequence[str], length: float) -> Figure:
    """The same against the horizon, every family at one smoothing length (zeroth order at its middle deviation)."""
    figure, grid = _grid(systems, f"smoothing length {length:g} m; zeroth order: deviation 0.01")
    for column, system in enumerate(systems):
        for family, style in STYLES.items():
            wanted = (None, 1e-2 if family == "zeroth order" else length)
            here = [r for r in rows if (r.system, r.family) == (system, family) and r.length in wanted]
            points = _largest(here)
            _draw(grid[:, column], style, points, [r.horizon for r in points])
    _horizons(grid, rows)
    _families(figure)
    return figure


def schedules(rows: Sequence[Quality], systems: Sequence[str]) -> Figure:
    """Constant kappa against kappa by distance in the derivative, over the horizon: a curve a smoothing length."""
    figure, grid = _grid(systems, "hard simulations; smoothing in the derivative alone")
    curves: dict[tuple[str, float | None], Style] = {("exact", None): STYLES["exact"]}
    for family, shades in SHADES.items():
        lengths = sorted({r.length for r in rows if r.family == family and r.length})
        curves |= {(family, x): (colour, *STYLES[family][1:]) for x, colour in zip(lengths, shades, strict=False)}
    for column, system in enumerate(systems):
        for (family, length), style in curves.items():
            points = [r for r in rows if (r.system, r.family, r.length) == (system, family, length)]
            _draw(grid[:, column], style, points, [r.horizon for r in points])
    _horizons(grid, rows)
    names = {"exact": "hard", "barrier": "constant kappa (BS)", "adaptive": "kappa by distance (ABS)"}
    _legend(figure, {f"{names[f]}{f', {1000 * x:g} mm' if x else ''}": style for (f, x), style in curves.items()}, 5)
    return figure


def against_cost(
    rows: Sequence[Quality], systems: Sequence[str], horizon: int, cost: dict[str, dict[str, float]]
) -> Figure:
    """The same against microseconds a sample: every length and bundle size is a point; down and left is better."""
    figure, grid = _grid(systems, f"horizon of {horizon} control steps, all smoothing lengths and bundle sizes")
    for column, system in enumerate(systems):
        for family, style in STYLES.items():
            here = [r for r in rows if (r.system, r.horizon, r.family) == (system, horizon, family)]
            points = [r for r in here if r.arm in cost[system]]
            _draw(grid[:, column], style, points, [cost[system][r.arm] for r in points], line=False)
        grid[1, column].set_xlabel("processor time of a sample [µs]", fontsize="small")
    _finish(grid)
    _families(figure)
    return figure


def _largest(points: list[Quality]) -> list[Quality]:
    """Those with the largest bundle, where there are bundles."""
    size = max((r.bundle or 0 for r in points), default=0)
    return [r for r in points if (r.bundle or 0) == size]


def _grid(systems: Sequence[str], title: str) -> tuple[Figure, Any]:
    figure, grid = panels(2, len(systems), 3.1 * len(systems) + 0.8, 6.6, sharey=True, sharex="col")
    figure.suptitle(f"{title}; all relative to the norm of the true gradient", fontsize="medium")
    for axes, system in zip(grid[0], systems, strict=True):
        axes.set_title(system, fontsize="medium")
    grid[0, 0].set_ylabel("bias")
    grid[1, 0].set_ylabel("deviation of one sample")
    return figure, grid


def _draw(pair: Sequence[Axes], style: Style, points: Sequence[Quality], x: Sequence[float], line: bool = True) -> None:
    """Bias in the first of ``pair``, open where it is within twice its error; deviation in the second."""
    colour, dash, marker = style
    for axes, values in zip(pair, ([r.bias for r in points], [r.deviation for r in points]), strict=True):
        y = np.clip(values, LOW, HIGH)
        if points and np.isnan(x[0]):  # no smoothing at all: a level
            axes.axhline(y[0], color=colour, lw=1.2)
            continue
        axes.plot(x, y, color=colour, ls=dash if line else "none", lw=1.2)
        for r, at, value, shown in zip(points, x, values, y, strict=True):
            beyond = value > HIGH
            face = "white" if axes is pair[0] and not r.resolved else colour
            axes.plot(at, shown, color=colour, marker="^" if beyond else marker, ms=9 if beyond else 5, mfc=face,
                      clip_on=False)  # fmt: skip
    if points and points[0].family == "exact":
        pair[0].axhline(np.clip(points[-1].reference_error, LOW, HIGH), color="0.6", ls=":", lw=1.2)


def _finish(grid: Any) -> None:
    for axes in grid.ravel():
        axes.set(xscale="log", yscale="log", ylim=(LOW, HIGH))
        axes.grid(alpha=0.3)
        axes.xaxis.set_minor_formatter(NullFormatter())
        if np.log10(axes.get_xlim()[1] / axes.get_xlim()[0]) < 2:
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def _horizons(grid: Any, rows: Sequence[Quality]) -> None:
    _finish(grid)
    ticks = sorted({r.horizon for r in rows})
    for axes in grid.ravel():
        axes.set_xticks(ticks, [str(x) for x in ticks])
        axes.set_xticks([], minor=True)
    for axes in grid[1]:
        axes.set_xlabel("horizon [control steps]", fontsize="small")


def _families(figure: Figure) -> None:
    _legend(figure, {FAMILIES[family]: style for family, style in STYLES.items()}, 3)


def _legend(figure: Figure, styles: dict[str, Style], ncols: int) -> None:
    handles = [Line2D([], [], color=c, ls=d, marker=m, ms=5, label=label) for label, (c, d, m) in styles.items()]
    legend_below(figure, ncols=ncols, handles=handles)
