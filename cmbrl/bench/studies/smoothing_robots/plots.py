"""The picture of the study: curves of every seed, and differences of the published rule seed by seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.smoothing.plan import PUBLISHED
from cmbrl.bench.studies.smoothing.plots import COLOURS, RIVALS, draw_gains
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
        arms = {equal: cells for (equal, of), cells in judged.items() if of == scene}
        draw_gains(
            bottom, {e: {rival: gain(one[PUBLISHED], one[rival]) for rival in RIVALS} for e, one in arms.items()}
        )
        for one in (top, bottom):
            one.grid(alpha=0.3)
    axes[0, 0].set_ylabel("return in the hard scene")
    axes[1, 0].set_ylabel("gain of the published rule over ... [%]")
    legend_below(figure, axes[0])
    save(figure, path)
