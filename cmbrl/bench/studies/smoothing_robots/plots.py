"""The picture of the study: curves of every seed, and differences of the published rule seed by seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.smoothing.plan import CONSTANT, EQUAL, GAUSSIAN, HARD, PUBLISHED
from cmbrl.bench.studies.smoothing.plots import COLOURS
from cmbrl.bench.studies.smoothing_robots.tables import UPDATES, Judged, gain


def draw(judged: Judged, path: Path) -> None:
    """A column for each scene: returns over updates, then gains by seed."""
    scenes = list(dict.fromkeys(scene for _, scene in judged))
    figure, axes = panels(2, len(scenes), 4.6 * len(scenes), 7.5)
    for scene, (top, bottom) in zip(scenes, axes.T, strict=True):
        for family, cell in judged[UPDATES, scene].items():
            values = np.array(cell["returns"], dtype=float)
            top.plot(cell["updates"], values, color=COLOURS[family], lw=0.6, alpha=0.3)
            top.plot(cell["updates"], values.mean(axis=1), color=COLOURS[family], lw=2.4, label=family, zorder=3)
        top.set_title(scene, fontsize="medium")
        top.set_xlabel("updates")
        _gains(bottom, judged, scene)
        for one in (top, bottom):
            one.grid(alpha=0.3)
    axes[0, 0].set_ylabel("return in the hard scene")
    axes[1, 0].set_ylabel("gain of the published rule over ... [%]")
    legend_below(figure, axes[0])
    save(figure, path)


def _gains(axes: Axes, judged: Judged, scene: str) -> None:
    rivals = (HARD, CONSTANT, GAUSSIAN)
    axes.axhspan(-100 * EQUAL, 100 * EQUAL, color="0.9", lw=0)
    axes.axhline(0, color="0.4", lw=0.8)
    for equal, arms in ((equal, arms) for (equal, of), arms in judged.items() if of == scene):
        shift = -0.17 if equal == UPDATES else 0.17
        for k, rival in enumerate(rivals):
            found = gain(arms[PUBLISHED], arms[rival])
            face, colour = (COLOURS[rival] if equal == UPDATES else "none"), COLOURS[rival]
            x = k + shift + np.linspace(-0.1, 0.1, len(found.by_seed))
            axes.scatter(x, 100 * found.by_seed, s=14, facecolors=face, edgecolors=colour, lw=0.8, alpha=0.7)
            spread = [[100 * (found.mean - found.low)], [100 * (found.high - found.mean)]]
            axes.errorbar(k + shift, 100 * found.mean, spread, fmt="_", color="0.2", ms=14, capsize=5, zorder=4)
    axes.set_xticks(range(len(rivals)), rivals)
