"""The picture of the study: curves of every seed, and differences of the published rule seed by seed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.smoothing.cells import Outcome
from cmbrl.bench.studies.smoothing.plan import AIM, CONSTANT, EQUAL, GAUSSIAN, HARD, PUBLISHED
from cmbrl.bench.studies.smoothing.tables import UPDATES, Judged
from cmbrl.bench.studies.smoothing.verdicts import Gain, gain, measure_of
from cmbrl.bench.studies.throws.cells import TASKS

RIVALS = (HARD, CONSTANT, GAUSSIAN)  #: of the published rule
COLOURS = {HARD: "black", CONSTANT: "#2171b5", GAUSSIAN: "#d39400", PUBLISHED: "#cb181d"}


def draw(judged: Judged, path: Path) -> None:
    """A column for each task: hits and distances over updates, then gains by seed."""
    tasks = list(dict.fromkeys(task for _, task in judged))
    figure, axes = panels(3, len(tasks), 4.4 * len(tasks), 9.5)
    for task, (top, middle, bottom) in zip(tasks, axes.T, strict=True):
        for family, cell in judged[UPDATES, task].items():
            curve = np.array(cell["distances"], dtype=float)
            _lines(top, cell, 100 * (curve < AIM).mean(axis=2), family)
            _lines(middle, cell, curve.mean(axis=2), family)
        top.set_title(f"{task}: {TASKS[task]}", fontsize="medium")
        middle.set_xlabel("updates")
        _gains(bottom, judged, task)
        for one in (top, middle, bottom):
            one.grid(alpha=0.3)
    axes[0, 0].set_ylabel("launches within 5 cm [%]")
    axes[1, 0].set_ylabel("mean distance to the goal [m]")
    axes[2, 0].set_ylabel("gain of the published rule over ...")
    legend_below(figure, axes[0])
    save(figure, path)


def _lines(axes: Axes, cell: Outcome, values: np.ndarray, family: str) -> None:
    """values (T, seeds)."""
    axes.plot(cell["updates"], values, color=COLOURS[family], lw=0.6, alpha=0.3)
    axes.plot(cell["updates"], values.mean(axis=1), color=COLOURS[family], lw=2.4, label=family, zorder=3)


def _gains(axes: Axes, judged: Judged, task: str) -> None:
    found, words = {}, {}
    for equal, arms in ((equal, arms) for (equal, of), arms in judged.items() if of == task):
        words[equal] = measure_of(arms)
        found[equal] = {rival: gain(arms[PUBLISHED], arms[rival], words[equal]) for rival in RIVALS}
    draw_gains(axes, found)
    unit = "% of its distance" if "distance" in words.values() else "points of hits"
    axes.set_title(f"[{unit}]", fontsize="small")


def draw_gains(axes: Axes, gains: Mapping[str, Mapping[str, Gain]]) -> None:
    """A column for each of RIVALS, with what is gained over it [%] by seed: filled at equal updates, else hollow."""
    axes.axhspan(-100 * EQUAL, 100 * EQUAL, color="0.9", lw=0)
    axes.axhline(0, color="0.4", lw=0.8)
    for equal, by_rival in gains.items():
        shift = -0.17 if equal == UPDATES else 0.17
        for k, rival in enumerate(RIVALS):
            found = by_rival[rival]
            face, colour = (COLOURS[rival] if equal == UPDATES else "none"), COLOURS[rival]
            x = k + shift + np.linspace(-0.1, 0.1, len(found.by_seed))
            axes.scatter(x, 100 * found.by_seed, s=14, facecolors=face, edgecolors=colour, lw=0.8, alpha=0.7)
            spread = [[100 * (found.mean - found.low)], [100 * (found.high - found.mean)]]
            axes.errorbar(k + shift, 100 * found.mean, spread, fmt="_", color="0.2", ms=14, capsize=5, zorder=4)
    axes.set_xticks(range(len(RIVALS)), RIVALS)
