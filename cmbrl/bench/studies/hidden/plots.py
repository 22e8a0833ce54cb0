"""The picture of the study: a panel for each robot and family, a line for each draw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.hidden.arms import FIT, NOMINAL, ORACLE
from cmbrl.bench.studies.hidden.judge import Result
from cmbrl.bench.studies.hidden.pairs import Runs
from cmbrl.bench.studies.hidden.plan import FAMILIES, SCENES

STATIONS = (NOMINAL, FIT, ORACLE)
COLOUR, RIVAL = "#08519c", "#d94801"


def draws(cells: Sequence[Result], path: Path) -> None:
    """Every draw from the nominal file through the fit to the true parameters, as far as run; randomised beside it."""
    runs = Runs.of(cells)
    scenes = [scene for scene in SCENES if any(cell["scene"] == scene for cell in cells)]
    figure, grid = panels(len(scenes), len(FAMILIES), 11.0, 3.3 * len(scenes) + 0.5, sharey="row", sharex=True)
    for scene, row in zip(scenes, grid, strict=True):
        for family, axes in zip(FAMILIES, row, strict=True):
            _panel(axes, runs, scene, family)
            if scene == scenes[0]:
                axes.set_title(family, fontsize="medium")
        row[0].set_ylabel(f"{scene}: real return")
    legend_below(figure)
    save(figure, path)


def _panel(axes: Axes, runs: Runs, scene: str, family: str) -> None:
    known = [k for k, arm in enumerate(STATIONS) if any(runs.returns(scene, name, arm) for name in FAMILIES)]
    found = [runs.returns(scene, family, STATIONS[k]) for k in known]
    for draw in sorted(set().union(*found)):
        heights = [station.get(draw, np.nan) for station in found]
        axes.plot(range(len(known)), heights, "o-", color=COLOUR, lw=0.9, ms=3.5, alpha=0.7, label="one draw")
    rival = runs.rival(scene, family)
    if rival is not None:
        heights = [*runs.returns(scene, family, rival).values()]
        x = -0.25 * np.ones(len(heights))
        axes.plot(x, heights, "D", color=RIVAL, mfc="none", ms=4, label="randomised, best width")
    axes.set_xticks(range(len(known)), [("nominal", "fit", "true")[k] for k in known])
    axes.set_xlim(-0.5, len(known) - 0.7)
    axes.grid(alpha=0.3, axis="y")
