"""``cmbrl bench stiffness``: what a model learns from 1,000 transitions, by the stiffness of the ground.

After Parmar, Halm, Posa, "Fundamental Challenges in Deep Learning for Stiff Contact Dynamics" (arXiv 2103.15406), who
trained networks on a simulated cube at stiffness 100 to 2,500. Damping, tosses and models are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.stiffness.cells import QUICK, Work, run
from cmbrl.bench.studies.stiffness.tosses import FRICTION
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress
from cmbrl.files import atomic_path

_STYLES = {
    "soft, fitted": ("#084594", "o", "-", "complementarity, MuJoCo's softness, fitted"),
    "soft, nominal": ("#9ecae1", "o", "--", "the same, nominal (time constant 0.02 s)"),
    "rigid, fitted": ("#006d2c", "^", "-", "complementarity, rigid law, fitted"),
    "rigid, nominal": ("#a1d99b", "^", "--", "the same, nominal"),
    "neural ensemble": ("#d94801", "s", "-", "neural ensemble"),
    "ballistic": ("0.5", "x", ":", "ballistic flight, no contact"),
}
_PANELS = (
    ("all", "error of v', all rows\n(1: standard deviation of the change)"),
    ("contact", "error of v', rows in contact\n(same unit)"),
    ("turn", "error of angular velocity [rad/s], all rows"),
)
Outcome = dict[str, Any]  # {"stiffness", "seed", "models": model -> errors}


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    torch.set_num_threads(1)
    work = QUICK if settings.quick else Work()
    cells = [(k, settings.seed + s) for k in work.stiffness for s in range(work.seeds)]
    done: list[Outcome] = []
    for i, (stiffness, seed) in enumerate(cells):
        progress(i / len(cells), f"stiffness {stiffness:g}, seed {seed}")

        def compute(stiffness: float = stiffness, seed: int = seed) -> Outcome:
            return {"stiffness": stiffness, "seed": seed, "models": run(stiffness, seed, work)}

        key = {"stiffness": stiffness, "seed": seed, "rows": work.rows, "test_rows": work.test_rows,
               "updates": work.updates, "budget": asdict(work.budget)}  # fmt: skip
        done.append(kept(folder / f"stiffness_{stiffness:g}_seed_{seed}.json", key, compute))
    return section(done, folder, work.rows)


def section(cells: Sequence[Outcome], folder: Path, rows: int) -> Section:
    """Picture into ``folder``, table and text of finished cells."""
    plot(cells, folder / "stiffness.png")
    text = (
        f"A simulated cube (MuJoCo, RK4 at 0.84 ms) tossed on ground of stiffness 100 to 2,500 per unit of mass; "
        f"every model learns from the same {rows:,} transitions of 6.8 ms and is judged one step ahead on other tosses."
        f" The physical models start from the task's MJCF, whose friction (0.3 for {FRICTION}), stiffness (2,500) and "
        "damping are guesses, and keep as many parameters as held-out tosses ask for. 'MuJoCo's softness' is the law "
        "of the system; the rigid law is a wrong one, to see how far it bends. An error of 1 is that of predicting the "
        "mean change; a nominal model may be worse than that."
    )
    caption = "One dot a seed, lines through the medians. Left and middle: relative to the change; right: absolute."
    figure = Figure("stiffness.png", "One-step error by stiffness of the ground", caption)
    return Section("Contact stiffness", text, [_table(cells)], [figure], {"cells": list(cells)})


def _table(cells: Sequence[Outcome]) -> Table:
    rows: list[list[Cell]] = [
        [cell["stiffness"], cell["seed"], name, e["all"], e["contact"], e["flight"], e["turn"], e["seconds"]]
        for cell in cells
        for name, e in cell["models"].items()
    ]
    columns = ["stiffness", "seed", "model", "all", "contact", "flight", "rad/s", "training s"]
    note = "Root mean square error of v': relative to the change (all, contact, flight) and of angular velocity."
    return Table("One-step error by stiffness", columns, rows, note)


def plot(cells: Sequence[Outcome], path: Path) -> None:
    """Three panels of error against stiffness; what is not finite is left to the table."""
    figure = Canvas(figsize=(12.5, 4.9), layout="constrained")
    FigureCanvasAgg(figure)
    levels = sorted({cell["stiffness"] for cell in cells})
    for axes, (key, label) in zip(figure.subplots(1, len(_PANELS)), _PANELS, strict=True):
        for name, (colour, marker, dash, long) in _STYLES.items():
            found = [(cell["stiffness"], cell["models"][name][key]) for cell in cells if name in cell["models"]]
            axes.plot(*zip(*found, strict=True), marker, color=colour, ms=4, alpha=0.7)
            middle = [np.median([e for k, e in found if k == level]) for level in levels]
            axes.plot(levels, middle, dash, color=colour, lw=1.3, label=long if key == "all" else None)
        axes.set(xscale="log", yscale="log", xlabel="stiffness of the ground [1/s^2]")
        axes.set_ylabel(label, fontsize="small")
        axes.set_xticks(levels, [f"{level:g}" for level in levels])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=140)


STUDY = Study("stiffness", "one-step error of fitted and neural models by stiffness of contact", with_progress(_study))
