"""The pictures of the mission: real return against real transitions, and against training time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.policies.methods import LOOP, MBPO_LOG, MBPO_ONLINE, NOMINAL, PPO_ONLINE, SAC_ONLINE, SHAC_NEURAL
from cmbrl.files import atomic_path

STYLES = {
    LOOP: ("#08519c", "o"),
    NOMINAL: ("0.35", "_"),
    MBPO_LOG: ("#fdae6b", "v"),
    SHAC_NEURAL: ("#cb181d", "s"),
    MBPO_ONLINE: ("#d94801", "^"),
    SAC_ONLINE: ("#238b45", "D"),
    PPO_ONLINE: ("#6a51a3", "P"),
}
REPORTED = {"hopper": [(50_000, 1700), (75_000, 3100), (100_000, 3300), (120_000, 3350)]}
"""MBPO's return after so many transitions: Janner et al. 2019 (arXiv 1906.08253), read by eye from the plot."""
_AXES = {"transitions": ("transitions", "real transitions"), "seconds": ("wall", "seconds of training (wall clock)")}


def draw(scene: str, results: Sequence[dict[str, Any]], kind: str, folder: Path) -> str:
    """Writes one picture of a scene's runs, ``kind`` "transitions" or "seconds"; its file name."""
    figure = Figure(figsize=(8.6, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    key, label = _AXES[kind]
    named: set[str] = set()
    for result in results:
        _run(axes, result, key, named)
    if kind == "transitions" and scene in REPORTED:
        axes.plot(*zip(*REPORTED[scene], strict=True), "*", color="#d94801", mfc="none", ms=10,
                  label="MBPO as reported (from its authors' plot)")  # fmt: skip
    axes.set(xscale="log", xlabel=label, ylabel="return in the real system", title=scene)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    file = f"{scene}_{kind}.png"
    with atomic_path(folder / file) as temporary:
        figure.savefig(temporary, dpi=140)
    return file


def _run(axes: Axes, result: dict[str, Any], key: str, named: set[str]) -> None:
    """One run: its curve where the abscissa moves along it, and its last policy."""
    method = result["method"]
    colour, marker = STYLES[method]
    real = [x for x in (result.get("real") or {}).get("returns", ()) if x is not None]
    if not real:
        return
    last = float(np.mean(real))
    label = None if method in named else method
    named.add(method)
    if key == "transitions" and not result[key]:
        axes.axhline(last, color=colour, ls="--", lw=0.9, alpha=0.7, label=label)
        return
    curve = [(p[key], p["real"]) for p in result["curve"] if p["real"] is not None]
    if len({x for x, _ in curve}) > 1:
        axes.plot(*zip(*curve, strict=True), "-", color=colour, lw=0.8, alpha=0.6)
    axes.plot(result[key], last, marker, color=colour, ms=6, alpha=0.8, label=label)
