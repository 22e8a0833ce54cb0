"""Pictures of the bank: scene x simulator at a glance, and error against step size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter

from cmbrl.bench.studies.stability.case import BankScene
from cmbrl.bench.studies.stability.measure import ABSENT, FAIL, NEAR, PASS
from cmbrl.bench.studies.stability.tables import Cells, swept
from cmbrl.files import atomic_path

COLOURS = {PASS: "#c7e9c0", NEAR: "#fff2b3", FAIL: "#f7b6a8", ABSENT: "#eeeeee"}
MARKS = {PASS: "✓", NEAR: "≈", FAIL: "✗", ABSENT: ""}
LINES = ("#084594", "#e7298a", "#6baed6", "#d94801", "#fdae6b", "#7a0177", "#636363", "#238b45")
CEILING = 10.0  #: where errors beyond it, and runs that blew up, are drawn


def heat_map(
    scenes: Sequence[BankScene], names: Sequence[str], cells: Cells, steps: dict[str, float], path: Path
) -> None:
    """Verdict by colour and glyph, error in the cell; the families apart."""
    order = (PASS, NEAR, FAIL, ABSENT)
    grid = np.array([[order.index(cells[s.label, n, steps[s.label]].verdict) for n in names] for s in scenes])
    figure = Figure(figsize=(2.9 + 1.15 * len(names), 1.5 + 0.3 * len(scenes)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.imshow(grid, cmap=ListedColormap([COLOURS[k] for k in order]), norm=BoundaryNorm(np.arange(5) - 0.5, 4),
                aspect="auto")  # fmt: skip
    for i, scene in enumerate(scenes):
        for j, name in enumerate(names):
            cell = cells[scene.label, name, steps[scene.label]]
            if cell.error is None:
                text = "–"
            elif np.isinf(cell.error):
                text = f"{MARKS[FAIL]} blew up"
            else:
                text = f"{MARKS[cell.verdict]} {cell.error:.0e}".replace("e-0", "e-").replace("e+0", "e")
                text += "°" * cell.partial
            axes.text(j, i, text, ha="center", va="center", fontsize=7, family="DejaVu Sans")
        if i and scene.family != scenes[i - 1].family:
            axes.axhline(i - 0.5, color="0.2", lw=1.2)
    axes.set_xticks(range(len(names)), [n.replace(", ", "\n").replace(" rel", "\nrel") for n in names], fontsize=8)
    axes.set_yticks(range(len(scenes)), [s.name for s in scenes], fontsize=8)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.set_xticks(np.arange(len(names)) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(scenes)) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=1)
    axes.tick_params(which="minor", length=0)
    labels = [f"{MARKS[k]} {k}".strip() for k in order]
    handles: list[Artist] = [_patch(COLOURS[k], label) for k, label in zip(order, labels, strict=True)]
    handles.append(Line2D([], [], ls="none", label="° some cases not expressible"))
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    _save(figure, path)


def curves(scenes: Sequence[BankScene], names: Sequence[str], cells: Cells, path: Path) -> None:
    """Error against h, one panel a scene; the tolerance dashed; what blew up is drawn at the top."""
    columns = 4
    rows = -(-len(scenes) // columns)
    figure = Figure(figsize=(3.1 * columns, 2.5 * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes in panels[len(scenes) :]:
        axes.axis("off")
    for axes, scene in zip(panels, scenes, strict=False):
        for name, colour in zip(names, LINES, strict=False):
            h, error = swept(scene.label, name, cells)
            if not len(h):
                continue
            high = error > CEILING
            shown = np.clip(error, 1e-12, CEILING)
            front = name == names[0]
            axes.loglog(h, shown, "o-", color=colour, ms=6 if front else 3, lw=3.5 if front else 1.1, label=name,
                        zorder=1 if front else 2)  # fmt: skip
            axes.loglog(h[high], shown[high], "x", color=colour, ms=8, mew=2, zorder=4)
        h = np.array(sorted({h for label, _, h in cells if label == scene.label}))
        axes.loglog(h, [scene.tolerance(x) for x in h], "k--", lw=1, label="tolerance")
        axes.set_title(scene.name, fontsize=9)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(1e-12 / 3, CEILING * 3)
        axes.grid(alpha=0.3)
        axes.tick_params(labelsize=7)
    figure.supxlabel("physics step h [s]", fontsize=9)
    figure.supylabel("error, share of the scene's scale (x: off the chart, or blew up)", fontsize=9)
    handles: dict[str, Artist] = {}
    for axes in panels[: len(scenes)]:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    labels = [n for n in (*names, "tolerance") if n in handles]
    figure.legend([handles[n] for n in labels], labels, loc="outside upper center", ncols=len(labels), frameon=False,
                  fontsize=8)  # fmt: skip
    _save(figure, path)


def _patch(colour: str, label: str) -> Patch:
    return Patch(facecolor=colour, edgecolor="0.5", label=label)


def _save(figure: Figure, path: Path) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)
