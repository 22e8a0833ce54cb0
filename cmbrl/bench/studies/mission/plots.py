"""The pictures of the mission: real return against real transitions, and against training time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from cmbrl.bench.studies.mission.methods import (
    LOOP,
    LOOP_ABS,
    MBPO_LOG,
    MBPO_ONLINE,
    NOMINAL,
    PPO_ONLINE,
    SAC_ONLINE,
    SHAC_NEURAL,
)
from cmbrl.files import atomic_path

STYLES = {
    LOOP: ("#08519c", "o"),
    LOOP_ABS: ("#6baed6", "o"),
    NOMINAL: ("0.35", "x"),
    MBPO_LOG: ("#fdae6b", "v"),
    SHAC_NEURAL: ("#cb181d", "s"),
    MBPO_ONLINE: ("#d94801", "^"),
    SAC_ONLINE: ("#238b45", "D"),
    PPO_ONLINE: ("#6a51a3", "P"),
}
REPORTED = {"hopper": [(50_000, 1700), (75_000, 3100), (100_000, 3300), (120_000, 3350)]}
"""MBPO's return after so many transitions: Janner et al. 2019 (arXiv 1906.08253), read by eye from the plot."""
TRANSITIONS, TIME = "transitions", "time"
_PANELS = {
    TRANSITIONS: {"transitions": "real transitions"},
    TIME: {"cpu": "processor seconds of training", "wall": "wall clock of training [s]"},
}
_ASIDE = {LOOP: 1.0, LOOP_ABS: 0.8, MBPO_LOG: 1.25, SHAC_NEURAL: 1.4}  # of the abscissa, where transitions are equal
_BESIDE = 1.025  # from one run of a method to the next


def draw(scene: str, results: Sequence[dict[str, Any]], kind: str, folder: Path) -> str:
    """Writes one picture of a scene's runs, ``kind`` TRANSITIONS or TIME; its file name."""
    panels = _PANELS[kind]
    figure = Figure(figsize=(5.2 * len(panels) + 2.0, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (key, label) in zip(
        figure.subplots(1, len(panels), sharey=True, squeeze=False)[0], panels.items(), strict=True
    ):
        for method in STYLES:
            own = [result for result in results if result["method"] == method]
            for k, result in enumerate(own):
                _run(axes, result, key, _BESIDE ** (k - (len(own) - 1) / 2))
        axes.set(xscale="log", xlabel=label)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.grid(alpha=0.3)
    first = figure.axes[0]
    if kind == TRANSITIONS and scene in REPORTED:
        first.plot(*zip(*REPORTED[scene], strict=True), "*", color="#d94801", mfc="none", ms=10,
                   label="MBPO as reported (its authors' plot)")  # fmt: skip
    first.set(ylabel=f"{scene}: return in the real system")
    handles = dict(zip(*reversed(first.get_legend_handles_labels()), strict=True))  # one of each method's runs
    figure.legend(handles.values(), handles, loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    file = f"{scene}_{kind}.png"
    with atomic_path(folder / file) as temporary:
        figure.savefig(temporary, dpi=140)
    return file


def _run(axes: Axes, result: dict[str, Any], key: str, beside: float) -> None:
    """One run: its curve, where there is one along this axis, and its last policy.

    ``beside``: of the abscissa, so that runs on as many transitions do not hide each other.
    """
    method = result["method"]
    colour, marker = STYLES[method]
    real = [x for x in (result.get("real") or {}).get("returns", ()) if x is not None]
    if not real or result[key] is None:
        return
    last = float(np.mean(real))
    if not result[key]:
        axes.axhline(last, color=colour, ls="--", lw=0.9, alpha=0.7, label=method)
        return
    curve = [(p[key], p["real"]) for p in result["curve"] if p["real"] is not None]
    if len({x for x, _ in curve}) > 1:
        axes.plot(*zip(*curve, strict=True), "-", color=colour, lw=0.8, alpha=0.6)
    aside = beside * _ASIDE[method] if key == "transitions" and method in _ASIDE else 1.0
    axes.plot(aside * result[key], last, marker, color=colour, ms=6, alpha=0.8, label=method)
