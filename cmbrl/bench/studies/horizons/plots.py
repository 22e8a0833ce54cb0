"""Pictures of gradients and short trainings against the horizon; colours are those of the other policy studies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from cmbrl.bench.studies.estimators.contenders import CONTENDERS, EXACT
from cmbrl.bench.studies.horizons.cells import NAMES
from cmbrl.bench.studies.horizons.situations import SITUATIONS
from cmbrl.files import atomic_path

_ROWS = {"norm": "norm of the mean", "signal": "norm / standard error", "cosine": "cosine to the truth"}


def qualities(found: Sequence[dict[str, Any]], places: Sequence[str], path: Path) -> None:
    """One column a situation; rows: norm, signal, cosine."""
    figure = Canvas(figsize=(4.2 * len(places) + 0.6, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(_ROWS), len(places), squeeze=False, sharex=True, sharey="row")
    for column, place in enumerate(places):
        here = [f for f in found if f["situation"] == place]
        for axes, key in zip(panels[:, column], _ROWS, strict=True):
            for name in NAMES:
                points = sorted((f["horizon"], f[key]) for f in here if f["name"] == name and f[key] is not None)
                if points:
                    wide = 3.0 if name == EXACT else 1.3  # smoothed ones may lie on it
                    axes.plot(*zip(*points, strict=True), "o-", color=CONTENDERS[name].colour, ms=3 + wide, lw=wide,
                              label=name)  # fmt: skip
            if key in ("norm", "signal"):
                _reference(axes, here, f"truth_{key}")
                axes.set_yscale("log")
            _horizons(axes, here)
        panels[1, column].axhline(1.0, color="0.5", lw=0.8)
        panels[2, column].axhline(0.0, color="0.5", lw=0.8)
        panels[-1, column].set_xlabel("horizon [control steps]")
        panels[0, column].set_title(SITUATIONS[place].title, fontsize="medium")
    for axes, label in zip(panels[:, 0], _ROWS.values(), strict=True):
        axes.set_ylabel(label)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=8, frameon=False)
    _save(figure, path)


def gains(learned: Sequence[dict[str, Any]], places: Sequence[str], path: Path) -> None:
    """Gain against the horizon, one panel a situation; estimators side by side at each horizon."""
    figure = Canvas(figsize=(4.6 * len(places) + 0.6, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(places), squeeze=False)[0]
    for axes, place in zip(panels, places, strict=True):
        here = [x for x in learned if x["situation"] == place]
        for k, name in enumerate(NAMES):
            shift = 1.05 ** (k - len(NAMES) // 2)  # beside each other on the log axis
            mine = sorted((x["horizon"], x["gains"]) for x in here if x["name"] == name)
            colour = CONTENDERS[name].colour
            for horizon, values in mine:
                axes.plot([horizon * shift] * len(values), values, "o", color=colour, ms=4, alpha=0.6)
            middle = [(horizon * shift, np.median(values)) for horizon, values in mine]
            axes.plot(*zip(*middle, strict=True), color=colour, lw=1.3, label=name)
        axes.axhline(0.0, color="0.5", lw=0.8)
        if max(abs(g) for x in here for g in x["gains"]) > 10:
            axes.set_yscale("symlog", linthresh=1.0)
        axes.set(xlabel="horizon [control steps]", title=SITUATIONS[place].title)
        _horizons(axes, here)
    panels[0].set_ylabel("gain of return / its first standard deviation")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=7, frameon=False)
    _save(figure, path)


def _reference(axes: Axes, here: Sequence[dict[str, Any]], key: str) -> None:
    points = sorted({(f["horizon"], f[key]) for f in here})
    axes.plot(*zip(*points, strict=True), "--", color="0.5", lw=1.2, label="truth")


def _horizons(axes: Axes, here: Sequence[dict[str, Any]]) -> None:
    ticks = sorted({f["horizon"] for f in here})
    axes.set_xscale("log")
    axes.set_xticks(ticks, [str(x) for x in ticks])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)


def _save(figure: Canvas, path: Path) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130)
