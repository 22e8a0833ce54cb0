"""Pictures of the throws: a family of estimators has one hue in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.studies.throws.cells import SCENES, Outcome
from cmbrl.bench.studies.throws.contenders import CONTENDERS, FAMILIES, of_family
from cmbrl.bench.studies.throws.models import TASKS
from cmbrl.files import atomic_path

AIM = 0.05  #: m
_LEAST = 1e-4  # m, what is nearer is drawn there


def learning_curves(cells: Sequence[Outcome], path: Path) -> None:
    """Distance in the model against iterations; a row for each task, a column for each family of estimators."""
    tasks, names = _of(cells, "task"), tuple(_of(cells, "contender"))
    figure = _canvas(13, 3.1 * len(tasks) + 0.6)
    panels = figure.subplots(len(tasks), len(FAMILIES), sharex=True, sharey=True, squeeze=False)
    for row, task in zip(panels, tasks, strict=True):
        row[0].set_ylabel(f"{task}\ndistance to the goal [m]")
        for axes, family in zip(row, FAMILIES, strict=True):
            for name in of_family(family, names):
                cell = next(c for c in cells if c["task"] == task and c["contender"] == name)
                distances, colour = np.array(cell["model"]).clip(_LEAST), CONTENDERS[name].colour
                axes.plot(distances, color=colour, lw=0.4, alpha=0.25)
                axes.plot(np.median(distances, axis=1), color=colour, lw=2.2, label=name)
            axes.axhline(AIM, color="0.4", ls=":", lw=1)
            axes.set_yscale("log")
            axes.grid(alpha=0.3)
            if task == tasks[0]:
                axes.set_title(family, fontsize="medium")
                axes.legend(fontsize="x-small", loc="lower left")
            axes.set_xlabel(f"iteration of {cell['steps'] // max(1, len(distances) - 1)} model steps")
    _save(figure, path)


def real_distances(cells: Sequence[Outcome], path: Path) -> None:
    """Last decisions of every run, thrown in the real system; the number on the right: share within the aim."""
    tasks, names = _of(cells, "task"), _of(cells, "contender")
    figure = _canvas(13, 0.42 * len(names) + 1.8)
    rng = np.random.default_rng(0)
    for axes, task in zip(np.atleast_1d(figure.subplots(1, len(tasks), sharey=True)), tasks, strict=True):
        for k, name in enumerate(names):
            for shift, scene in zip((-0.2, 0.2), SCENES, strict=True):
                found = next(c for c in cells if (c["task"], c["contender"], c["scene"]) == (task, name, scene))
                x = np.array(found["real"]).clip(_LEAST)
                face = CONTENDERS[name].colour if scene == SCENES[0] else "none"
                y = k + shift + rng.uniform(-0.1, 0.1, len(x))
                axes.scatter(x, y, s=13, facecolors=face, edgecolors=CONTENDERS[name].colour, lw=0.7, alpha=0.8)
                axes.text(1.01, k + shift, f"{np.mean(x < AIM):.0%}", transform=axes.get_yaxis_transform(),
                          fontsize="x-small", va="center")  # fmt: skip
        axes.axvline(AIM, color="0.4", ls=":", lw=1)
        axes.set(xscale="log", xlabel="real distance to the goal [m]", title=f"{task}: {TASKS[task]}")
        axes.title.set_fontsize("small")
        axes.set_yticks(range(len(names)), names)
        axes.grid(alpha=0.3, axis="x")
    figure.axes[0].invert_yaxis()
    _save(figure, path)


def variances(cells: Sequence[Outcome], lengths: Sequence[int], substeps: int, path: Path) -> None:
    """Median over decisions of the gradient's variance against the length of the throw in model steps."""
    tasks, names = _of(cells, "task"), _of(cells, "contender")
    figure = _canvas(12.5, 4.4)
    steps = np.array(lengths) * substeps
    for axes, task in zip(np.atleast_1d(figure.subplots(1, len(tasks), sharey=True)), tasks, strict=True):
        for name in names:
            cell = next(c for c in cells if c["task"] == task and c["contender"] == name)
            axes.plot(steps, medians(cell), "o-", ms=4, lw=1.3, color=CONTENDERS[name].colour, label=name)
        axes.set(xscale="log", yscale="log", xlabel="physics steps of the throw (1 ms)", title=task)
        axes.set_xticks(steps, [str(x) for x in steps])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("variance of a gradient of one throw's cost [m$^4$]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    _save(figure, path)


def medians(cell: Outcome) -> list[float]:
    """Over decisions, for each length; one that has no finite gradient counts as infinite."""
    return [float(np.median([np.inf if x is None else x for x in row])) for row in cell["variance"]]


def mission(rows: Sequence[Outcome], path: Path) -> None:
    """Real distance by the number of recorded throws: a dot for each seed from the middle, a cross over starts."""
    tasks, counts = _of(rows, "task"), sorted({r["throws"] for r in rows})
    figure = _canvas(11, 4.0)
    for axes, task in zip(np.atleast_1d(figure.subplots(1, len(tasks), sharey=True)), tasks, strict=True):
        for k, count in enumerate(counts):
            found = [r for r in rows if r["task"] == task and r["throws"] == count]
            x = k + np.linspace(-0.25, 0.25, len(found))
            axes.plot(x, [max(r["real"], _LEAST) for r in found], "o", color="#cb181d", ms=5, label="from the middle")
            axes.plot(x, [max(r["spread"], _LEAST) for r in found], "x", color="0.4", ms=5, label="mean over starts")
        axes.axhline(AIM, color="0.4", ls=":", lw=1)
        axes.set(yscale="log", xlabel="recorded throws", title=f"{task}: {TASKS[task]}")
        axes.title.set_fontsize("small")
        axes.set_xticks(range(len(counts)), [str(x) for x in counts])
        axes.grid(alpha=0.3, axis="y")
    figure.axes[0].set_ylabel("real distance to the goal [m]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], loc="outside lower center", ncols=2, frameon=False)
    _save(figure, path)


def _of(cells: Sequence[Outcome], key: str) -> list[str]:
    return list(dict.fromkeys(c[key] for c in cells))


def _canvas(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130)
