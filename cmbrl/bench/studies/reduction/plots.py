"""The picture of the reduction study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmbrl.bench.figures import panels


def bars(rows: Sequence[dict[str, Any]]) -> Figure:
    """A bar for every scene and variant, with the ratio to the first variant of its scene."""
    figure, grid = panels(1, 1, 8, 0.34 * len(rows) + 1.6)
    axes = grid[0, 0]
    first = {row["scene"]: row["variant"] for row in reversed(rows)}
    reduced = np.array([row["variant"] == first[row["scene"]] for row in rows])
    places = np.cumsum(np.where(reduced, 1.6, 1.0))
    low, middle, high = 1e6 * np.array([[row["seconds"][key] for key in ("low", "median", "high")] for row in rows]).T
    colours = np.where(reduced, "#084594", "0.65")
    axes.barh(places, middle, color=colours, xerr=[middle - low, high - middle], error_kw={"lw": 0.7})
    for place, row, time, end, plain in zip(places, rows, middle, high, reduced, strict=True):
        text = f"{time:.2g} us" if plain else f"{row['ratio']['median']:.2g}x"
        axes.annotate(text, (end, place), (4, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(places, [f"{row['scene']}: {row['variant']}" for row in rows], fontsize="small")
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="microseconds per physics step, one core")
    axes.margins(x=0.12)
    axes.grid(alpha=0.3, axis="x")
    axes.set_title("blue: the reduced scene; grey: the same motion without reduction", fontsize="medium")
    return figure
