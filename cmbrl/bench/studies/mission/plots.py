"""The pictures of the mission: real return against real transitions, and against training time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.mission.arms import ARMS
from cmbrl.bench.studies.mission.runs import Result
from cmbrl.bench.studies.mission.tables import mean

REPORTED = {"hopper": [(50_000, 1700), (75_000, 3100), (100_000, 3300), (120_000, 3350)]}
"""MBPO's return after so many transitions: Janner et al. 2019 (arXiv 1906.08253), read by eye from the plot."""


def transitions(scene: str, results: Sequence[Result], path: Path) -> None:
    """Left, arm by arm: runs that all took the same number of transitions. Right: the others, over transitions."""
    counts = {arm: {p["transitions"] for r in _of(results, arm) for p in (r, *r["curve"])} for arm in ARMS}
    fixed = [arm for arm, found in counts.items() if len(found) == 1]
    figure, ((strip, axes),) = panels(1, 2, 10.5, 5.4, sharey=True, width_ratios=(2, 3))
    for k, arm in enumerate(fixed):
        own = _of(results, arm)
        for x, result in zip(k + np.linspace(-0.25, 0.25, len(own) + 2)[1:-1], own, strict=True):
            _last(strip, arm, x, result)
    strip.set_xticks(range(len(fixed)), [f"{next(iter(counts[arm])):,}" for arm in fixed])
    strip.set(xlim=(-0.6, len(fixed) - 0.4), xlabel="real transitions given", ylabel=f"{scene}: real return")
    strip.grid(alpha=0.3, axis="y")
    for arm in ARMS:
        if arm not in fixed:
            _curves(axes, results, arm, "transitions")
    if scene in REPORTED:
        axes.plot(*zip(*REPORTED[scene], strict=True), "*", color="#d94801", mfc="none", ms=10,
                  label="MBPO as reported (its authors' plot)")  # fmt: skip
    _log(axes, "real transitions collected")
    legend_below(figure, ncols=3)
    save(figure, path)


def times(scene: str, results: Sequence[Result], path: Path) -> None:
    """Real return over processor time and over wall-clock time of training."""
    figure, (row,) = panels(1, 2, 12.4, 5.2, sharey=True)
    for axes, key, label in zip(row, ("cpu", "wall"), ("processor time", "wall-clock time"), strict=True):
        for arm in ARMS:
            _curves(axes, results, arm, key)
        _log(axes, f"{label} of training [s]")
    row[0].set_ylabel(f"{scene}: real return")
    legend_below(figure, ncols=3)
    save(figure, path)


def _curves(axes: Axes, results: Sequence[Result], arm: str, key: str) -> None:
    """Every run of an arm: its curve and its last policy."""
    for result in _of(results, arm):
        curve = [(p[key], p["real"]) for p in result["curve"] if p["real"] is not None]
        if len(curve) > 1:
            axes.plot(*zip(*curve, strict=True), "-", color=ARMS[arm].colour, lw=0.8, alpha=0.6)
        _last(axes, arm, result[key], result)


def _last(axes: Axes, arm: str, x: float, result: Result) -> None:
    value = mean(result, "real")
    axes.plot(x, np.nan if value is None else value, ARMS[arm].marker, color=ARMS[arm].colour, ms=6, alpha=0.8,
              label=arm, ls="")  # fmt: skip


def _log(axes: Axes, label: str) -> None:
    axes.set(xscale="log", xlabel=label)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.7g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(alpha=0.3)


def _of(results: Sequence[Result], arm: str) -> list[Result]:
    return [r for r in results if r["arm"] == arm]
