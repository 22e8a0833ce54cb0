"""Pictures of gradients and short trainings against the horizon; colours are those of the study ``estimators``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from cmbrl.bench.figures import legend_below, panels, save
from cmbrl.bench.studies.estimators.arms import ARMS
from cmbrl.bench.studies.horizons.cells import NAMES, Outcome
from cmbrl.bench.studies.horizons.situations import SITUATIONS

_ROWS = {"norm": "norm of the mean", "signal": "norm / standard error", "cosine": "cosine to the reference"}


def qualities(found: Sequence[Outcome], places: Sequence[str], path: Path) -> None:
    """One column a situation; rows: norm, signal, cosine, with their intervals."""
    figure, axes = panels(3, len(places), 4.2 * len(places) + 0.6, 8.5, sharex=True, sharey="row")
    for place, column in zip(places, axes.T, strict=True):
        here = [f for f in found if f["situation"] == place]
        for one, key in zip(column, _ROWS, strict=True):
            for name in NAMES:
                mine = [(x, cell) for x, cell in _dodged(here, name) if cell[key] is not None]
                style = {"color": ARMS[name].colour, "lw": 1.1}
                one.plot([x for x, _ in mine], [cell[key] for _, cell in mine], "o-", ms=4, label=name, **style)
                for x, cell in mine:
                    one.plot([x, x], cell.get(f"{key}_range") or [np.nan] * 2, **style)
            if key != "cosine":
                truth = sorted({(f["horizon"], f[f"truth_{key}"]) for f in here})
                one.plot(*zip(*truth, strict=True), "--", color="0.5", lw=1.2, label="reference")
                one.set_yscale("log")
            _horizons(one, here)
        column[1].axhline(1.0, color="0.5", lw=0.8)
        column[2].axhline(0.0, color="0.5", lw=0.8)
        column[2].set_xlabel("horizon [control steps]")
        column[0].set_title(SITUATIONS[place].title, fontsize="medium")
    for one, label in zip(axes[:, 0], _ROWS.values(), strict=True):
        one.set_ylabel(label)
    legend_below(figure, ncols=8)
    save(figure, path)


def gains(learned: Sequence[Outcome], places: Sequence[str], path: Path) -> None:
    """Gain against the horizon, one panel a situation; estimators side by side at each horizon."""
    figure, axes = panels(1, len(places), 4.6 * len(places) + 0.6, 4.8)
    for place, one in zip(places, axes[0], strict=True):
        here = [x for x in learned if x["situation"] == place]
        for name in NAMES:
            mine, colour = _dodged(here, name), ARMS[name].colour
            for x, cell in mine:
                one.plot([x] * len(cell["gains"]), cell["gains"], "o", color=colour, ms=4, alpha=0.6)
            one.plot(*zip(*[(x, np.median(cell["gains"])) for x, cell in mine], strict=True), color=colour, lw=1.3,
                     label=name)  # fmt: skip
        one.axhline(0.0, color="0.5", lw=0.8)
        if max(abs(g) for x in here for g in x["gains"]) > 10:
            one.set_yscale("symlog", linthresh=1.0)
        one.set(xlabel="horizon [control steps]", title=SITUATIONS[place].title)
        _horizons(one, here)
    axes[0, 0].set_ylabel("gain of return / its first standard deviation")
    legend_below(figure, ncols=7)
    save(figure, path)


def _dodged(here: Sequence[Outcome], name: str) -> list[tuple[float, Outcome]]:
    """An arm's cells by horizon, moved sideways so that arms do not hide each other."""
    shift = 1.04 ** (NAMES.index(name) - len(NAMES) // 2)
    mine = sorted((x for x in here if x["arm"] == name), key=lambda x: int(x["horizon"]))
    return [(cell["horizon"] * shift, cell) for cell in mine]


def _horizons(axes: Axes, here: Sequence[Outcome]) -> None:
    ticks = sorted({f["horizon"] for f in here})
    axes.set_xscale("log")
    axes.set_xticks(ticks, [str(x) for x in ticks])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)
