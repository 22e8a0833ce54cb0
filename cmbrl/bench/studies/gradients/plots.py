"""Pictures of the estimators: bias and deviation against smoothing length, horizon and cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.gradients.arms import FAMILIES
from cmbrl.bench.studies.gradients.cells import Quality

STYLES = {
    "exact": ("black", "-", "o"), "barrier": ("#1f77b4", "-", "s"), "gaussian": ("#d62728", "-", "^"),
    "barrier, both": ("#6baed6", "--", "P"), "gaussian, both": ("#fc8d59", "--", "X"),
    "randomised": ("#2ca02c", "-", "D"), "zeroth order": ("#9467bd", "-", "v"),
}  #: colour, line, marker by family  # fmt: skip
SCHEDULES = {
    "barrier": ("constant kappa (BS)", ("#c6dbef", "#6baed6", "#2171b5", "#08306b")),
    "gaussian": ("kappa by distance (our Gaussian schedule)", ("#fcbba1", "#fb6a4a", "#cb181d", "#67000d")),
}  #: name, and colours from short to long smoothing lengths
LOW, HIGH = 1e-3, 1e3  #: relative errors are drawn inside these; arrows mark larger ones


@dataclass(frozen=True)
class Curve:
    """One entry of the legend, and the cells that belong to it."""

    label: str
    style: tuple[str, str, str]
    rows: Sequence[Quality]


def against_length(rows: Sequence[Quality], horizon: int) -> Figure:
    """Every family at one horizon."""
    curves = _families(_largest(r for r in rows if r.horizon == horizon))
    xlabel = "smoothing length [m]\n(zeroth order: deviation of parameters)"
    return _picture(curves, f"horizon of {horizon} control steps", xlabel, lambda r: r.length or np.nan)


def against_horizon(rows: Sequence[Quality], length: float) -> Figure:
    """Every family at one smoothing length, zeroth order at its middle deviation."""
    wanted = {"exact": None, "zeroth order": 1e-2}
    curves = _families(_largest(r for r in rows if r.length == wanted.get(r.family, length)))
    return _over_horizons(curves, f"smoothing length {length:g} m; zeroth order: deviation 0.01")


def schedules(rows: Sequence[Quality]) -> Figure:
    """Constant kappa against kappa by distance in the derivative, a curve a smoothing length."""
    curves = [Curve("hard", STYLES["exact"], [r for r in rows if r.family == "exact"])]
    for family, (name, colours) in SCHEDULES.items():
        lengths = sorted({r.length for r in rows if r.family == family and r.length})
        for length, colour in zip(lengths, colours, strict=False):
            own = [r for r in rows if (r.family, r.length) == (family, length)]
            curves.append(Curve(f"{name}, {1000 * length:g} mm", (colour, *STYLES[family][1:]), own))
    return _over_horizons(curves, "hard simulations; smoothing in the derivative alone")


def against_cost(rows: Sequence[Quality], horizon: int, cost: Mapping[str, Mapping[str, float]]) -> Figure:
    """Every length and bundle size at one horizon as a point; down and left is better."""
    curves = _families([r for r in rows if r.horizon == horizon])
    title = f"horizon of {horizon} control steps, all smoothing lengths and bundle sizes"
    return _picture(curves, title, "processor time of a sample [µs]", lambda r: cost[r.system][r.arm], line=False)


def _families(rows: Sequence[Quality]) -> list[Curve]:
    return [Curve(FAMILIES[f], style, [r for r in rows if r.family == f]) for f, style in STYLES.items()]


def _largest(rows: Iterable[Quality]) -> list[Quality]:
    """Without smaller bundles than the largest."""
    held = list(rows)
    size = max((r.bundle or 0 for r in held), default=0)
    return [r for r in held if r.bundle in (None, size)]


def _over_horizons(curves: Sequence[Curve], title: str) -> Figure:
    ticks = sorted({r.horizon for curve in curves for r in curve.rows})
    figure = _picture(curves, title, "horizon [control steps]", lambda r: r.horizon)
    for axes in figure.axes:
        axes.set_xticks(ticks, [str(x) for x in ticks])
        axes.set_xticks([], minor=True)
    return figure


def _picture(
    curves: Sequence[Curve], title: str, xlabel: str, x: Callable[[Quality], float], line: bool = True
) -> Figure:
    """Two rows of panels, bias above and deviation below, one column a system."""
    systems = list(dict.fromkeys(r.system for curve in curves for r in curve.rows))
    figure, grid = panels(2, len(systems), 3.1 * len(systems) + 0.8, 6.6, sharey=True, sharex="col")
    figure.suptitle(f"{title}; all relative to the norm of the true gradient", fontsize="medium")
    for column, system in zip(grid.T, systems, strict=True):
        column[0].set_title(system, fontsize="medium")
        for curve in curves:
            points = [r for r in curve.rows if r.system == system]
            at = [x(r) for r in points]
            _draw(column[0], curve, at, [r.bias for r in points], [r.resolved for r in points], line)
            _draw(column[1], curve, at, [r.deviation for r in points], [True] * len(points), line)
        longest = max((r for c in curves for r in c.rows if r.system == system), key=lambda r: r.horizon)
        column[0].axhline(np.clip(longest.reference_error, LOW, HIGH), color="0.6", ls=":", lw=1.2)
        column[1].set_xlabel(xlabel, fontsize="small")
    for axes in grid.ravel():
        axes.set(xscale="log", yscale="log", ylim=(LOW, HIGH))
        axes.grid(alpha=0.3)
        axes.xaxis.set_minor_formatter(NullFormatter())
        if np.log10(axes.get_xlim()[1] / axes.get_xlim()[0]) < 2:
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    for axes, name in zip(grid[:, 0], ("bias", "deviation of one sample"), strict=True):
        axes.set_ylabel(name)
    looks = [(curve.label, *curve.style) for curve in curves]
    handles = [Line2D([], [], color=c, ls=d, marker=m, ms=5, label=label) for label, c, d, m in looks]
    legend_below(figure, ncols=3, handles=handles)
    return figure


def _draw(
    axes: Axes, curve: Curve, at: Sequence[float], values: Sequence[float], full: Sequence[bool], line: bool
) -> None:
    """A point is open unless ``full``; a curve without smoothing length is a level."""
    (colour, dash, marker), y = curve.style, np.clip(values, LOW, HIGH)
    if at and np.isnan(at[0]):
        axes.axhline(y[0], color=colour, lw=1.2)
        return
    axes.plot(at, y, color=colour, ls=dash if line else "none", lw=1.2)
    for k, value in enumerate(values):
        beyond = value > HIGH
        axes.plot(at[k], y[k], color=colour, marker="^" if beyond else marker, ms=9 if beyond else 5,
                  mfc=colour if full[k] else "white", clip_on=False)  # fmt: skip
