"""Pictures of the estimators: bias and deviation against smoothing length, against horizon, against cost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from cmbrl.bench.studies.gradients.contenders import FAMILIES
from cmbrl.bench.studies.gradients.measure import Quality
from cmbrl.files import atomic_path

STYLES = {
    "exact": ("black", "-", "o"),
    "barrier": ("#1f77b4", "-", "s"),
    "adaptive": ("#d62728", "-", "^"),
    "barrier, both": ("#6baed6", "--", "P"),
    "adaptive, both": ("#fc8d59", "--", "X"),
    "randomised": ("#2ca02c", "-", "D"),
    "zeroth order": ("#9467bd", "-", "v"),
}
LOW, HIGH = 1e-3, 1e3  #: relative errors are drawn inside these; arrows mark what lies above


def against_length(rows: Sequence[Quality], systems: Sequence[str], horizon: int, path: Path) -> None:
    """Two rows of panels, bias above and deviation below, one column a system."""
    figure, panels = _grid(systems, f"horizon of {horizon} control steps")
    for column, system in enumerate(systems):
        here = [r for r in rows if r.system == system and r.horizon == horizon]
        for family in FAMILIES:
            points = [r for r in here if r.family == family]
            if family == "randomised":
                points = [r for r in points if r.bundle == max(p.bundle or 0 for p in points)]
            _draw(panels[:, column], family, points, [r.length or np.nan for r in points])
        panels[1, column].set_xlabel("smoothing length [m]\n(zeroth order: deviation of parameters)", fontsize="small")
    _finish(figure, panels, path)


def against_horizon(rows: Sequence[Quality], systems: Sequence[str], length: float, path: Path) -> None:
    """The same against the horizon, every family at one smoothing length (zeroth order at its middle deviation)."""
    figure, panels = _grid(systems, f"smoothing length {length:g} m; zeroth order: deviation 0.01")
    for column, system in enumerate(systems):
        here = [r for r in rows if r.system == system]
        for family in FAMILIES:
            wanted = 1e-2 if family == "zeroth order" else length
            points = [r for r in here if r.family == family and r.length in (None, wanted)]
            if family == "randomised":
                points = [r for r in points if r.bundle == max(p.bundle or 0 for p in points)]
            _draw(panels[:, column], family, points, [r.horizon for r in points])
        panels[1, column].set_xlabel("horizon [control steps]", fontsize="small")
    _finish(figure, panels, path, ticks=sorted({r.horizon for r in rows}))


def against_cost(
    rows: Sequence[Quality], systems: Sequence[str], horizon: int, cost: dict[str, dict[str, float]], path: Path
) -> None:
    """The same against microseconds a sample: every length and bundle size is a point; down and left is better."""
    figure, panels = _grid(systems, f"horizon {horizon}, all smoothing lengths and bundle sizes")
    for column, system in enumerate(systems):
        here = [r for r in rows if r.system == system and r.horizon == horizon and r.contender in cost[system]]
        for family in FAMILIES:
            points = [r for r in here if r.family == family]
            _draw(panels[:, column], family, points, [cost[system][r.contender] for r in points], line=False)
        panels[1, column].set_xlabel("us a sample", fontsize="small")
    _finish(figure, panels, path)


def _grid(systems: Sequence[str], title: str) -> tuple[Figure, Any]:
    figure = Figure(figsize=(3.1 * len(systems) + 0.8, 6.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, len(systems), squeeze=False, sharey=True, sharex="col")
    figure.suptitle(f"{title}; all relative to the norm of the true gradient", fontsize="medium")
    for axes, system in zip(panels[0], systems, strict=True):
        axes.set_title(system, fontsize="medium")
    panels[0, 0].set_ylabel("bias")
    panels[1, 0].set_ylabel("deviation of one sample")
    return figure, panels


def _draw(
    panels: Sequence[Axes], family: str, points: Sequence[Quality], x: Sequence[float], line: bool = True
) -> None:
    """Bias in panels[0], hollow where it is within twice its error; deviation in panels[1]."""
    colour, dash, marker = STYLES[family]
    for axes, values in zip(panels, ([r.bias for r in points], [r.deviation for r in points]), strict=True):
        y = np.clip(values, LOW, HIGH)
        if points and np.isnan(x[0]):  # no smoothing at all: a level
            axes.axhline(y[0], color=colour, lw=1.2, label=FAMILIES[family])
            continue
        axes.plot(x, y, color=colour, ls=dash if line else "none", lw=1.2, label=FAMILIES[family],
                  marker="none")  # fmt: skip
        for r, at, value, shown in zip(points, x, values, y, strict=True):
            hollow = axes is panels[0] and not r.resolved
            beyond = value > HIGH
            axes.plot(at, shown, color=colour, marker="^" if beyond else marker, ms=9 if beyond else 5,
                      mfc="white" if hollow else colour, clip_on=False)  # fmt: skip
    if points and family == "exact":
        panels[0].axhline(np.clip(points[-1].reference_error, LOW, HIGH), color="0.6", ls=":", lw=1.2)


def _finish(figure: Figure, panels: Any, path: Path, ticks: Sequence[int] = ()) -> None:
    for axes in panels.ravel():
        axes.set(xscale="log", yscale="log", ylim=(LOW, HIGH))
        axes.grid(alpha=0.3)
        axes.xaxis.set_minor_formatter(NullFormatter())
        if ticks:
            axes.set_xticks(ticks, [str(x) for x in ticks])
            axes.set_xticks([], minor=True)
        elif np.log10(axes.get_xlim()[1] / axes.get_xlim()[0]) < 2:
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    handles = [
        panels[0, 0].plot([], [], color=c, ls=d, marker="none" if f == "exact" else m, ms=5, label=FAMILIES[f])[0]
        for f, (c, d, m) in STYLES.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=140)
