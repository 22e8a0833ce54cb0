"""Pictures of numbers: parameters with intervals, what is told only together, and the course of the search."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterSciNotation, MaxNLocator

from cmbrl.fitting.fitted_parameter import AT_BOUND, FITTED, FLAT, NOMINAL, FittedParameter
from cmbrl.fitting.outcome.page.style import AFTER, BEFORE, BOUND, FAINT, LOGGED, SMALL, new_figure, tidy
from cmbrl.fitting.search.space import Space

MOST_PARAMETERS = 64  #: drawn; the table has all
MOST_DIRECTIONS = 9
_LOG_FROM = 5.0  # times the smallest value
_STARTED = {"search": BEFORE}  # the colour of a stage; of the polishes that follow, AFTER
_COLUMN = 32  # parameters in a column
_COLOURS = {FITTED: AFTER, AT_BOUND: BOUND, FLAT: FAINT}
_WORDS = {FITTED: "fitted", AT_BOUND: "on a bound", FLAT: "hardly told by the log"}
_EDGE = 3.2  # prior standard deviations; bounds around a central value lie at 3


def parameters(space: Space, found: Mapping[str, FittedParameter]) -> tuple[Figure, int] | None:
    """Values and 95 % intervals in standard deviations of the prior, from the file's value; how many were left out."""
    moved = [name for name in space.names if found[name].status != NOMINAL]
    if not moved:
        return None
    z = {
        field: space.z(np.array([getattr(found[n], field) for n in space.names])) for field in ("value", "low", "high")
    }
    index = {name: k for k, name in enumerate(space.names)}
    by_size = sorted(moved, key=lambda name: (found[name].status == FLAT, -abs(z["value"][index[name]])))
    groups = list(dict.fromkeys(space.groups))
    drawn = sorted(by_size[:MOST_PARAMETERS], key=lambda name: (groups.index(space.groups[index[name]]), index[name]))
    columns = 1 if len(drawn) <= _COLUMN // 2 else 2
    height = -(-len(drawn) // columns)
    figure = new_figure(10.0, 0.9 + 0.21 * height)
    grid = figure.subplots(1, columns, squeeze=False)[0]
    for k, axes in enumerate(grid):
        names = drawn[k * height : (k + 1) * height]
        _forest(axes, names, height, found, {field: [v[index[n]] for n in names] for field, v in z.items()})
    present = {found[name].status for name in drawn}
    handles = [
        Line2D([], [], color=_COLOURS[status], marker="o", markersize=4, label=word)
        for status, word in _WORDS.items()
        if status in present
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    return figure, len(moved) - len(drawn)


def _forest(
    axes: Axes,
    names: Sequence[str],
    height: int,
    found: Mapping[str, FittedParameter],
    z: Mapping[str, Sequence[float]],
) -> None:
    axes.axvline(0.0, color=LOGGED, linewidth=0.8)
    group, shade = "", False
    for row, name in enumerate(names):
        p, color = found[name], _COLOURS.get(found[name].status, AFTER)
        if name.partition(".")[0] != group:
            group, shade = name.partition(".")[0], not shade
        if shade:
            axes.axhspan(row - 0.5, row + 0.5, color="0.955", linewidth=0)
        ends = np.clip([z["low"][row], z["high"][row]], -_EDGE, _EDGE)
        axes.plot(ends, [row, row], color=color, linewidth=2.2, alpha=0.75, solid_capstyle="butt")
        value = float(z["value"][row])
        marker = "o" if abs(value) <= _EDGE else ">" if value > 0 else "<"
        axes.plot(np.clip(value, -_EDGE, _EDGE), row, marker, color=color, markersize=4, clip_on=False)
        text = f"{p.nominal:.3g} → {p.shown:.3g}  [{p.low:.3g}, {p.high:.3g}]"
        axes.annotate(
            text, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=SMALL - 1.5, family="monospace"
        )
    axes.set_yticks(range(len(names)), [textwrap.shorten(n, 34, placeholder="…") for n in names], fontsize=SMALL - 1)
    axes.set(xlim=(-_EDGE, _EDGE), ylim=(height - 0.4, -0.6))
    axes.set_xlabel("prior standard deviations from the file's value", fontsize=SMALL)
    axes.tick_params(labelsize=SMALL, axis="x")
    axes.tick_params(length=0, axis="y")
    axes.grid(axis="x", alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right", "left"]].set_visible(False)


def together(report: Mapping[str, Any]) -> tuple[Figure, int] | None:
    """Combinations of several parameters that the log does not tell, weakest first; how many were left out."""
    found = [d for d in report.get("flat_directions", ()) if len(d["parameters"]) > 1]
    if not found:
        return None
    drawn = sorted(found, key=lambda d: d["information"])[:MOST_DIRECTIONS]
    columns = min(3, len(drawn))
    rows = -(-len(drawn) // columns)
    longest = [max(len(d["parameters"]) for d in drawn[k : k + columns]) for k in range(0, len(drawn), columns)]
    heights = [0.6 + 0.19 * count for count in longest]
    figure = new_figure(10.0, 0.2 + sum(heights))
    grid = figure.subplots(rows, columns, squeeze=False, height_ratios=heights)
    for k, (axes, direction) in enumerate(zip(grid.flat, drawn, strict=False)):
        names, values = zip(*direction["parameters"].items(), strict=True)
        places = np.arange(len(names))
        axes.barh(places, values, color=[AFTER if v > 0 else BOUND for v in values], height=0.65, alpha=0.85)
        axes.axvline(0.0, color=LOGGED, linewidth=0.8)
        axes.set_yticks(places, [textwrap.shorten(n, 30, placeholder="…") for n in names], fontsize=SMALL - 1)
        axes.set(xlim=(-1.08, 1.08), ylim=(longest[k // columns] - 0.4, -0.6))
        told = direction["information"]
        text = f"{told:.2g}" if told >= 0.001 else "less than 0.001"
        axes.set_title(f"the log tells {text} of the prior", fontsize=SMALL, loc="left")
        tidy(axes)
        axes.tick_params(axis="y", length=0, labelsize=SMALL - 1)
    for axes in grid.flat[len(drawn) :]:
        axes.set_visible(False)
    return figure, len(found) - len(drawn)


def course(report: Mapping[str, Any]) -> Figure | None:
    """Held-out loss by step of the selection, and the best objective by candidates of search and polish."""
    moves, searches = report.get("selection") or [], [s for s in report.get("course", ()) if s["best"]]
    panels = bool(moves) + bool(searches)
    if not panels:
        return None
    figure = new_figure(10.0, 3.2)
    grid = list(figure.subplots(1, panels, squeeze=False)[0])
    if moves:
        _selection(grid.pop(0), moves)
    if searches:
        _searches(grid.pop(0), searches)
    return figure


def _selection(axes: Axes, moves: Sequence[Mapping[str, Any]]) -> None:
    tidy(axes)
    start = moves[0]["held_out_loss"] + moves[0]["gain"]
    losses = [start, *(move["held_out_loss"] for move in moves)]
    axes.plot(range(len(losses)), losses, color=AFTER, marker="o", markersize=4)
    signs = {"add": "+", "remove": "−"}
    labels = [
        "file",
        *(f"{signs.get(m['move'], m['move'])} {textwrap.shorten(m['group'], 26, placeholder='…')}" for m in moves),
    ]
    axes.set_xticks(range(len(losses)), labels, rotation=35, ha="right", fontsize=SMALL - 0.5)
    axes.set(yscale="log", ylabel="loss on held-out episodes")
    axes.set_title("selection of groups", fontsize=9.5, loc="left")


def _searches(axes: Axes, searches: Sequence[Mapping[str, Any]]) -> None:
    tidy(axes)
    at, values = 0, list[float]()
    for search in searches:
        count, best = np.array(search["best"]).T
        axes.step(
            at + count,
            best,
            where="post",
            color=_STARTED.get(search["name"], AFTER),
            marker=".",
            markersize=4,
            label=search["name"],
        )
        values += best.tolist()
        at += int(count[-1])
    axes.set(xlabel="candidates", ylabel="best objective (loss and prior)", xlim=(0, None))
    if min(values) > 0 and max(values) > _LOG_FROM * min(values):
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(2.0, 0.5)))
        axes.tick_params(which="both", labelsize=SMALL)
    else:
        axes.set_ylim(0.0, 1.1 * max(values))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.set_title("search and polish", fontsize=9.5, loc="left")
    axes.legend(frameon=False, fontsize=9)
