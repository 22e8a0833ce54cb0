"""Pictures of the bank: scene x simulator at a glance, and error against step size."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.stability.bank import FIRST
from cmbrl.bench.studies.stability.case import BankScene
from cmbrl.bench.studies.stability.cells import ABSENT, FAIL, NEAR, PASS, Cell
from cmbrl.bench.studies.stability.tables import Results

CURVED = ("trajectory", "conservation")  #: kinds of scenes whose error is drawn against the step
COLOURS = {PASS: "#c7e9c0", NEAR: "#fff2b3", FAIL: "#f7b6a8", ABSENT: "#eeeeee"}
MARKS = {PASS: "✓", NEAR: "≈", FAIL: "✗", ABSENT: ""}
LINES = ("#084594", "#e7298a", "#6baed6", "#d94801", "#fdae6b", "#7a0177", "#636363", "#238b45")
FLOOR, CEILING = 1e-12, 10.0  #: errors beyond these, and runs that blew up, are drawn there


def heat_map(results: Results) -> Figure:
    """Verdict by colour and mark, error in the cell; a line between families."""
    scenes, names, order = results.scenes, results.names, tuple(COLOURS)
    cells = [[results.shown(scene, name) for name in names] for scene in scenes]
    figure, grid = panels(1, 1, 2.9 + 1.15 * len(names), 1.5 + 0.3 * len(scenes))
    axes: Axes = grid[0, 0]
    axes.imshow([[order.index(cell.verdict) for cell in row] for row in cells], aspect="auto",
                cmap=ListedColormap(list(COLOURS.values())), norm=BoundaryNorm(np.arange(5) - 0.5, 4))  # fmt: skip
    for i, row in enumerate(cells):
        for j, cell in enumerate(row):
            axes.text(j, i, _entry(cell), ha="center", va="center", fontsize=7, family="DejaVu Sans")
        if i and scenes[i].label in FIRST:
            axes.axhline(i - 0.5, color="0.2", lw=1.2)
    axes.set_xticks(range(len(names)), [n.replace(", ", "\n").replace(" rel", "\nrel") for n in names], fontsize=8)
    axes.set_yticks(range(len(scenes)), [s.name for s in scenes], fontsize=8)
    axes.xaxis.tick_top()
    axes.set_xticks(np.arange(len(names)) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(scenes)) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=1)
    axes.tick_params(which="both", length=0)
    patches = [Patch(facecolor=COLOURS[k], edgecolor="0.5", label=f"{MARKS[k]} {k}".strip()) for k in order]
    legend_below(figure, ncols=5, handles=[*patches, Line2D([], [], ls="none", label="° some cases not expressible")])
    return figure


def _entry(cell: Cell) -> str:
    if cell.error is None:
        return "–"
    if np.isinf(cell.error):
        return f"{MARKS[FAIL]} blew up"
    text = f"{MARKS[cell.verdict]} {cell.error:.0e}".replace("e-0", "e-").replace("e+0", "e")
    return text + "°" * cell.partial


def curves(results: Results) -> Figure:
    """Error against h, one panel a scene; the tolerance dashed; what blew up is drawn at the top."""
    scenes, columns = [s for s in results.scenes if s.kind in CURVED], 4
    rows = -(-len(scenes) // columns)
    figure, grid = panels(rows, columns, 3.1 * columns, 2.5 * rows + 0.5)
    for axes in grid.ravel()[len(scenes) :]:
        axes.axis("off")
    for axes, scene in zip(grid.ravel(), scenes, strict=False):
        _curves_of(axes, scene, results)
    figure.supylabel("error, share of the scene's scale (x: off the chart, or blew up)", fontsize=9)
    legend_below(figure, ncols=len(results.names) + 1)
    return figure


def _curves_of(axes: Axes, scene: BankScene, results: Results) -> None:
    for k, (name, colour) in enumerate(zip(results.names, LINES, strict=False)):
        h, error = results.swept(scene.label, name)
        if not len(h):
            continue
        high, shown = error > CEILING, np.clip(error, FLOOR, CEILING)
        size, width = (3, 1.1) if k else (6, 3.5)  # the first is drawn broad, behind the others
        axes.loglog(h, shown, "o-", color=colour, ms=size, lw=width, label=name, zorder=2 if k else 1)
        axes.loglog(h[high], shown[high], "x", color=colour, ms=8, mew=2, zorder=4)
    steps = sorted({h for label, _, h in results.cells if label == scene.label})
    axes.loglog(steps, [scene.tolerance(h) for h in steps], "k--", lw=1, label="tolerance")
    axes.set_title(scene.name, fontsize=9)
    axes.set_xlabel("physics step h [s]", fontsize=8)
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(FLOOR / 3, CEILING * 3)
    axes.grid(alpha=0.3)
    axes.tick_params(labelsize=7)
