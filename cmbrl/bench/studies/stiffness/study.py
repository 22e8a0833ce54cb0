"""``cmbrl bench stiffness``: what a model learns from 1,000 transitions, by the stiffness of the ground.

After Parmar, Halm, Posa, "Fundamental Challenges in Deep Learning for Stiff Contact Dynamics" (arXiv 2103.15406), who
trained networks on a simulated cube at stiffness 100 to 2,500. Damping, tosses and models differ from theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.stiffness.cells import QUICK, Work, cell
from cmbrl.bench.studies.stiffness.tosses import FRICTION
from cmbrl.bench.study import Cell, Section, Settings, Study, Table
from cmbrl.bench.words import Words
from cmbrl.jobs import Job, Runner

WORDS = Words("cmbrl.bench.studies.stiffness")
_STYLES = {
    "soft, fitted": ("#084594", "o", "-", "complementarity, MuJoCo's softness, fitted"),
    "soft, nominal": ("#9ecae1", "o", "--", "the same, nominal (time constant 0.02 s)"),
    "rigid, fitted": ("#006d2c", "^", "-", "complementarity, rigid law, fitted"),
    "rigid, nominal": ("#a1d99b", "^", "--", "the same, nominal"),
    "neural ensemble": ("#d94801", "s", "-", "neural ensemble"),
    "ballistic": ("0.5", "x", ":", "ballistic flight, no contact"),
}
_PANELS = {
    "all": "error of v', all rows\n(1: standard deviation of the change)",
    "contact": "error of v', rows in contact\n(same unit)",
    "turn": "error of angular velocity [rad/s], all rows",
}
Outcome = dict[str, Any]  # {"stiffness", "seed", "models": model -> errors}


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    work = QUICK if settings.quick else Work()
    cells = [(k, settings.seed + s) for k in work.stiffness for s in range(work.seeds)]
    jobs = [
        Job(f"stiffness {k:g} seed {seed}", cell, {"stiffness": k, "seed": seed, "work": work}) for k, seed in cells
    ]
    found = zip(cells, runner.run(jobs, "cell"), strict=True)
    done = [{"stiffness": k, "seed": seed, "models": models} for (k, seed), models in found]
    save(plot(done), folder / "stiffness.png", dpi=140)
    text = WORDS("method", rows=f"{work.rows:,}", friction=FRICTION)
    return Section(WORDS("title"), text, [table(done)], WORDS.figures(), {"cells": done})


def table(cells: Sequence[Outcome]) -> Table:
    """One row a stiffness, seed and model."""
    rows: list[list[Cell]] = [
        [cell["stiffness"], cell["seed"], name, e["all"], e["contact"], e["flight"], e["turn"], e["seconds"]]
        for cell in cells
        for name, e in cell["models"].items()
    ]
    columns = ["stiffness", "seed", "model", "all", "contact", "flight", "rad/s", "training s"]
    return Table("One-step error by stiffness", columns, rows, WORDS("table"))


def plot(cells: Sequence[Outcome]) -> Figure:
    """Three panels of error against stiffness; what is not finite is left to the table."""
    figure, grid = panels(1, len(_PANELS), 12.5, 4.9)
    levels = sorted({cell["stiffness"] for cell in cells})
    for axes, (key, label) in zip(grid[0], _PANELS.items(), strict=True):
        for name, (colour, marker, dash, long) in _STYLES.items():
            found = [(cell["stiffness"], cell["models"][name][key]) for cell in cells]
            axes.plot(*zip(*found, strict=True), marker, color=colour, ms=4, alpha=0.7)
            middle = [np.median([e for k, e in found if k == level]) for level in levels]
            axes.plot(levels, middle, dash, color=colour, lw=1.3, label=long)
        axes.set(xscale="log", yscale="log", xlabel="stiffness of the ground [1/s$^2$]")
        axes.set_ylabel(label, fontsize="small")
        axes.set_xticks(levels, [f"{level:g}" for level in levels])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    legend_below(figure, ncols=3)
    return figure


STUDY = Study("stiffness", "one-step error of fitted and neural models by stiffness of contact", run)
