"""Pictures of predictions: predicted against logged motion, and what is left, against what it may follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cmbrl.fitting.outcome.page.predictions import OneStep, Window
from cmbrl.fitting.outcome.page.style import AFTER, BEFORE, FAINT, LOGGED, SMALL, gridded, tidy
from cmbrl.scene import Scene

MOST = 12  #: coordinates drawn
MOST_RESIDUALS = 6
_BINS = 14
_LEAST_IN_BIN = 5
_FILE = "file"
_NEAR = 0.02  # [m] what never comes so near is told nothing by its gap
_BEYOND = 1.15  # axes show the log and the fit, with this margin; the file may leave them


def motion(scene: Scene, windows: Sequence[Window], dt: float) -> tuple[Figure, list[str]]:
    """Predicted against logged by coordinate; the names drawn, those of the largest errors relative to the motion."""
    logged = np.concatenate([w.logged for w in windows])
    errors = {field: _mean_error(windows, field) for field in ("before", "after")}
    drawn = np.sort(_worst(errors["after"] / np.maximum(logged.std(axis=0), 1e-9), MOST))
    columns = min(3, len(drawn))
    rows = -(-len(drawn) // columns)
    figure, grid = gridded(rows, columns, (10.0, 2.3), (0.78, 0.46))
    for k, c in enumerate(drawn):
        pair = grid[k // columns, k % columns].subgridspec(2, 1, height_ratios=[2.0, 1.0], hspace=0.12)
        above = figure.add_subplot(pair[0])
        below = figure.add_subplot(pair[1], sharex=above)
        above.tick_params(labelbottom=False)
        unit, small = ("m", "mm") if scene.coordinate_kinds[c] == "position" else ("rad", "mrad")
        _motion_of(above, below, windows, int(c), dt)
        told = " → ".join(f"{1e3 * errors[field][c]:.3g}" for field in ("before", "after"))
        above.set_title(f"{scene.coordinate_names[c]}   {told} {small}", fontsize=SMALL + 0.5, loc="left")
        above.set_ylabel(unit, fontsize=SMALL)
        below.set_ylabel(f"error [{small}]", fontsize=SMALL - 1)
        below.tick_params(labelbottom=k + columns >= len(drawn))
        if k + columns >= len(drawn):
            below.set_xlabel("time [s]", fontsize=SMALL)
    labels = ("logged", "file, before the fit", "fit, without these seconds")
    figure.legend(figure.axes[0].get_lines()[:3], labels, loc="upper center", ncols=3, frameon=False, fontsize=9)
    return figure, [scene.coordinate_names[c] for c in drawn]


def _motion_of(above: Axes, below: Axes, windows: Sequence[Window], c: int, dt: float) -> None:
    """Motion above, and below its error in thousandths."""
    at = 0.0
    for window in windows:
        time = at + dt * np.arange(len(window.logged))
        paths = {LOGGED: window.logged[:, c], BEFORE: window.before[:, c], AFTER: window.after[:, c]}
        for (color, path), width in zip(paths.items(), (1.6, 1.0, 1.2), strict=True):
            above.plot(time, path, color=color, linewidth=width)
            if color != LOGGED:
                below.plot(time, 1e3 * (path - paths[LOGGED]), color=color, linewidth=1.0)
        for axes in (above, below):
            axes.axvline(at, color=FAINT, linewidth=0.6, linestyle=":")
        at = time[-1] + 3 * dt
    below.axhline(0.0, color=LOGGED, linewidth=0.7)
    for axes in (above, below):
        tidy(axes)
        axes.set(xlim=(0.0, at - 3 * dt))
    shown = _finite([path[:, c] for window in windows for path in (window.logged, window.after)])
    middle, half = (shown.max() + shown.min()) / 2, max((shown.max() - shown.min()) / 2, 1e-6)
    above.set_ylim(middle - _BEYOND * half, middle + _BEYOND * half)
    fit, file = (
        float(np.abs(_finite([getattr(w, field)[:, c] - w.logged[:, c] for w in windows])).max())
        for field in ("after", "before")
    )
    reach = 1e3 * _BEYOND * max(fit, min(file, 3 * fit), 1e-9)
    below.set_ylim(-reach, reach)


def _finite(parts: Sequence[np.ndarray]) -> np.ndarray:
    """All finite values, or a zero where a model has left for infinity at once."""
    values = np.concatenate(parts)
    values = values[np.isfinite(values)]
    return values if len(values) else np.zeros(1)


def residuals(scene: Scene, found: OneStep) -> tuple[Figure, list[str]]:
    """Unexplained acceleration against command, speed, position and gap: medians and quartiles of equally full bins."""
    most = np.quantile(np.abs(found.after), 0.99, axis=0)  # of a few impacts no coordinate is the worst
    size = np.sqrt(np.mean(np.minimum(np.abs(found.after), most) ** 2, axis=0))
    drawn = np.sort(_worst(size / found.spread, MOST_RESIDUALS))
    touching = bool(found.gap.min(initial=np.inf) < _NEAR)
    axes_of = {"command": found.command, "speed": found.speed, "position": found.position}
    titles = ["against command", "against speed", "against position", *["against the smallest gap"] * touching]
    figure, places = gridded(len(drawn), len(titles), (10.0, 1.72), (0.85, 0.5))
    grid = places.subplots(squeeze=False, sharey="row")
    for row, c in zip(grid, drawn, strict=True):
        length = "m" if scene.coordinate_kinds[c] == "position" else "rad"
        units = {"command": "command", "speed": f"{length}/s", "position": length}
        panels = [(found_in[:, c], units[what]) for what, found_in in axes_of.items()]
        panels += [(1e3 * found.gap, "mm")] * touching
        reaches = [_binned(axes, x, found, int(c), unit) for axes, (x, unit) in zip(row, panels, strict=True)]
        row[0].set_ylabel(f"{scene.coordinate_names[c]}\n[{length}/s²]", fontsize=SMALL)
        _zoom(row, reaches)
    for axes, title in zip(grid[0], titles, strict=True):
        axes.set_title(title, fontsize=9)
    handles = next(h for h in (axes.get_legend_handles_labels() for axes in grid.flat) if h[0])
    figure.legend(*handles, loc="upper center", ncols=2, frameon=False, fontsize=9)
    return figure, [scene.coordinate_names[c] for c in drawn]


def _binned(axes: Axes, x: np.ndarray, found: OneStep, c: int, unit: str) -> tuple[float, float]:
    """Draws one panel; returns the largest of what is drawn of the fit, and of the file."""
    tidy(axes)
    axes.axhline(0.0, color=LOGGED, linewidth=0.7)
    axes.set_xlabel(unit, fontsize=SMALL - 0.5, labelpad=1)
    known = np.isfinite(x)
    if not known.any():
        axes.text(0.5, 0.5, "no actuator\nof its own", transform=axes.transAxes, ha="center", va="center", color=FAINT)
        axes.set(xticks=[], xlabel="")
        return 0.0, 0.0
    centres, _, file, _ = _quartiles(x[known], found.before[known, c])
    axes.plot(centres, file, color=BEFORE, linewidth=1.0, alpha=0.8, marker=".", markersize=3, label=_FILE)
    centres, low, middle, high = _quartiles(x[known], found.after[known, c])
    axes.fill_between(centres, low, high, color=AFTER, alpha=0.25, linewidth=0)
    axes.plot(centres, middle, color=AFTER, linewidth=1.4, marker=".", markersize=3.5, label="fit, without these rows")
    return float(np.abs([low, high]).max()), float(np.abs(file).max())


def _quartiles(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Median x, and quartiles of y, of bins of x that are about equally full."""
    bins = int(np.clip(len(x) // _LEAST_IN_BIN, 1, _BINS))
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, bins + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    full = [place == k for k in np.unique(place)]
    centres = np.array([np.median(x[mask]) for mask in full])
    return centres, *(np.array([np.nanquantile(y[mask], share) for mask in full]) for share in (0.25, 0.5, 0.75))


def _zoom(row: Sequence[Axes], reaches: Sequence[tuple[float, float]]) -> None:
    """Limits that show the fit whole, and of the file up to three times as much; ``reaches`` of both, by panel."""
    fit, file = np.nanmax(np.array(reaches), axis=0)
    reach = _BEYOND * float(max(fit, min(file, 3 * fit), 1e-9))
    row[0].set_ylim(-reach, reach)
    for line in (line for axes in row for line in axes.lines if line.get_label() == _FILE):
        medians = np.asarray(line.get_ydata(), dtype=float)
        line.set_ydata(np.where(np.abs(medians) <= reach, medians, np.nan))  # no strokes to what is not in the picture


def _mean_error(windows: Sequence[Window], field: str) -> np.ndarray:
    return np.concatenate([np.abs(getattr(w, field) - w.logged)[1:] for w in windows]).mean(axis=0)


def _worst(size: np.ndarray, most: int) -> np.ndarray:
    return np.argsort(-size, kind="stable")[:most]
