"""Pictures of the comparison on a known scene; an estimator has one colour in all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, SymmetricalLogLocator

from cmbrl.bench.figures import panels, save
from cmbrl.bench.studies.estimators.arms import ARMS
from cmbrl.bench.studies.estimators.cells import Outcome
from cmbrl.bench.studies.estimators.tables import Probes


def curves(outcomes: Sequence[Outcome], tasks: Sequence[str], groups: Mapping[str, Sequence[str]], path: Path) -> None:
    """Return against model steps and against seconds, two rows a task, a column for each group of estimators."""
    figure, axes = panels(2 * len(tasks), len(groups), 3.4 * len(groups) + 0.6, 5.2 * len(tasks) + 0.4, sharex="row")
    for k, row in enumerate(axes):
        task, key = tasks[k // 2], ("steps", "seconds")[k % 2]
        for one, names in zip(row, groups.values(), strict=True):
            one.sharey(axes[k // 2 * 2, 0])
            one.tick_params(labelleft=one is row[0])
            for name in names:
                _lines(one, [o for o in outcomes if (o["task"], o["arm"]) == (task, name)], key, name)
            one.set_xlabel({"steps": "model steps", "seconds": "seconds of processor time"}[key])
            one.grid(alpha=0.3)
            if key == "steps":
                one.set_xscale("log")
                one.xaxis.set_minor_formatter(NullFormatter())
        row[0].set_ylabel(f"{task}: return of an episode")
    for one, title in zip(axes[0], groups, strict=True):
        one.set_title(title, fontsize="medium")
        one.legend(fontsize="small", loc="best")
    save(figure, path)


def _lines(axes: Axes, runs: Sequence[Outcome], key: str, name: str) -> None:
    """Every run thin, the median thick; both end in the return that the table shows."""
    colour, paths = ARMS[name].colour, []
    for run in runs:
        y = [*(m["return"] for m in run["curve"][:-1]), np.mean(run["returns"])]
        path = np.array([[m[key] for m in run["curve"]], y])
        paths.append(path[:, 1:] if key == "steps" else path)  # no step has been taken at the first mark
        axes.plot(*paths[-1], color=colour, lw=0.7, alpha=0.5)
        if run["diverged"]:
            axes.plot(*paths[-1][:, -1], "x", color=colour, ms=8)
    whole = [path for path in paths if path.shape == max(p.shape for p in paths)]
    if whole:
        axes.plot(*np.median(whole, axis=0), color=colour, lw=2, marker="o", ms=3, label=name)


def qualities(probes: Probes, path: Path) -> None:
    """Noise, and slopes claimed and true, of every estimator at one policy; one row a task."""
    figure, axes = panels(len(probes), 2, 11, 3.6 * len(probes), sharey="row")
    for (noise, slopes), (task, found) in zip(axes, probes.items(), strict=True):
        for k, (name, f) in enumerate(found.items()):
            colour = ARMS[name].colour
            noise.plot(np.nan if f["noise"] is None else f["noise"], k, "o", color=colour)
            if f["claimed"] is None or f["true"] is None:
                continue
            for key, fill, off in (("claimed", "white", -0.12), ("true", colour, 0.12)):
                slopes.errorbar(f[key], k + off, xerr=2 * (f[f"{key}_error"] or 0.0), fmt="o", color=colour, mfc=fill,
                                capsize=3)  # fmt: skip
        noise.set_yticks(range(len(found)), list(found))
        noise.invert_yaxis()
        noise.set(xlim=(0, None), xlabel="noise: standard error / norm", title=task)
        noise.axvline(1.0, color="0.5", ls=":")
        # The axis turns linear below the largest error of a true slope, where signs mean little.
        least = 100.0 ** np.ceil(np.log10(max([f["true_error"] or 0.0 for f in found.values()] + [1e-9])) / 2)
        slopes.set_xscale("symlog", linthresh=least)
        slopes.xaxis.set_major_locator(SymmetricalLogLocator(base=100, linthresh=least))
        slopes.set_xlabel("slope along the estimate: claimed (open), true (full)")
        slopes.axvline(0.0, color="0.5", lw=0.8)
        for one in (noise, slopes):
            one.grid(alpha=0.3)
    save(figure, path)
