"""Pictures of the throws: a family of estimators has one hue in all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.throws.arms import ARMS, FAMILIES
from cmbrl.bench.studies.throws.cells import FITTED, KNOWN, TASKS, Outcome
from cmbrl.bench.studies.throws.tables import AIM, spread

Draw = Callable[[Axes, Outcome, str], None]
_LEAST = 1e-4  # m, nearer distances are drawn here


def learning_curves(cells: Sequence[Outcome], path: Path) -> None:
    """Distance in the model against iterations; a row for each task, a column for each family of estimators."""

    def draw(axes: Axes, cell: Outcome, colour: str) -> None:
        distances = np.array(cell["model"]).clip(_LEAST)
        axes.plot(distances, color=colour, lw=0.7, alpha=0.4)
        axes.plot(np.median(distances, axis=1), color=colour, lw=2.6, label=cell["arm"], zorder=3)
        axes.axhline(AIM, color="0.4", ls=":", lw=1)
        axes.set_xlabel(f"iteration of {cell['steps'] // max(1, len(distances) - 1)} model steps")

    _by_family(cells, "distance to the goal [m]", draw, path)


def variances(cells: Sequence[Outcome], lengths: Sequence[int], substeps: int, path: Path) -> None:
    """Variance of the gradient against the length of the throw: median and quartiles over decisions."""
    steps = np.array(lengths) * substeps

    def draw(axes: Axes, cell: Outcome, colour: str) -> None:
        low, middle, high = spread(cell)
        axes.fill_between(steps, low, high, color=colour, alpha=0.15, lw=0)
        axes.plot(steps, middle, "o-", ms=4, lw=1.5, color=colour, label=cell["arm"])
        axes.set(xscale="log", xlabel="physics steps of the throw (1 ms)")
        axes.set_xticks(steps, [str(x) for x in steps])
        axes.set_xticks([], minor=True)

    _by_family(cells, "variance [m$^4$]", draw, path)


def _by_family(cells: Sequence[Outcome], label: str, draw: Draw, path: Path) -> None:
    """Calls ``draw(axes, cell, colour)`` for every cell, in the panel of its task and family."""
    tasks = _of(cells, "task")
    figure, axes = panels(len(tasks), len(FAMILIES), 13, 3.1 * len(tasks) + 0.6, sharex=True, sharey=True)
    for task, row in zip(tasks, axes, strict=True):
        row[0].set(ylabel=f"{task}\n{label}", yscale="log")
        for family, one in zip(FAMILIES, row, strict=True):
            one.grid(alpha=0.3)
            for cell in cells:
                if cell["task"] == task and ARMS[cell["arm"]].family == family:
                    draw(one, cell, ARMS[cell["arm"]].colour)
    for family, one in zip(FAMILIES, axes[0], strict=True):
        one.set_title(family, fontsize="medium")
        one.legend(fontsize="x-small", loc="best")
    save(figure, path)


def real_distances(cells: Sequence[Outcome], path: Path) -> None:
    """Last decisions of every run, thrown in the real system; the number on the right: share within the aim."""
    names, rng = _of(cells, "arm"), np.random.default_rng(0)
    figure, axes = _by_task(cells, 13, 0.42 * len(names) + 1.8)
    for task, one in axes.items():
        for cell in [c for c in cells if c["task"] == task]:
            at = names.index(cell["arm"]) + {KNOWN: -0.2, FITTED: 0.2}[cell["scene"]]
            x, colour = np.array(cell["real"]).clip(_LEAST), ARMS[cell["arm"]].colour
            face = colour if cell["scene"] == KNOWN else "none"
            one.scatter(x, at + rng.uniform(-0.1, 0.1, len(x)), s=13, facecolors=face, edgecolors=colour, lw=0.7)
            one.text(1.01, at, f"{np.mean(x < AIM):.0%}", transform=one.get_yaxis_transform(), fontsize="x-small",
                     va="center")  # fmt: skip
        one.axvline(AIM, color="0.4", ls=":", lw=1)
        one.set(xscale="log", xlabel="real distance to the goal [m]")
        one.xaxis.set_minor_formatter(NullFormatter())
        one.set_yticks(range(len(names)), names)
        one.grid(alpha=0.3, axis="x")
    figure.axes[0].invert_yaxis()
    save(figure, path)


def planned(rows: Sequence[Outcome], path: Path) -> None:
    """Real distance against the number of recorded throws: a dot from the middle, a cross over starts, per seed."""
    counts = _of(sorted(rows, key=lambda r: r["throws"]), "throws")
    figure, axes = _by_task(rows, 11, 4.0)
    for task, one in axes.items():
        for k, count in enumerate(counts):
            found = [r for r in rows if (r["task"], r["throws"]) == (task, count)]
            x = k + np.linspace(-0.25, 0.25, len(found))
            one.plot(x, [max(r["real"], _LEAST) for r in found], "o", color="#cb181d", ms=5, label="from the middle")
            one.plot(x, [max(r["spread"], _LEAST) for r in found], "x", color="0.4", ms=5, label="mean over starts")
        one.axhline(AIM, color="0.4", ls=":", lw=1)
        one.set(yscale="log", xlabel="recorded throws")
        one.set_xticks(range(len(counts)), [str(x) for x in counts])
        one.grid(alpha=0.3, axis="y")
    figure.axes[0].set_ylabel("real distance to the goal [m]")
    legend_below(figure)
    save(figure, path)


def _by_task(cells: Sequence[Outcome], width: float, height: float) -> tuple[Figure, dict[str, Axes]]:
    """A figure with one panel a task, and the panels by task."""
    tasks = _of(cells, "task")
    figure, axes = panels(1, len(tasks), width, height, sharey=True)
    for task, one in zip(tasks, axes[0], strict=True):
        one.set_title(f"{task}: {TASKS[task]}", fontsize="small")
    return figure, dict(zip(tasks, axes[0], strict=True))


def _of(cells: Sequence[Outcome], key: str) -> list[Any]:
    return list(dict.fromkeys(c[key] for c in cells))
