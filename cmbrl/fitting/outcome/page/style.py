"""What all pictures of the page share: colours, letters, and the way from a figure into the page."""

from __future__ import annotations

import base64
import io
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

LOGGED, BEFORE, AFTER, BOUND, FAINT = "#1c2126", "#d9822b", "#1f6fb5", "#b3261e", "#9aa5b0"
_CSS_INCH = 96  # pixels
_DPI = 144
_LEGEND, _BELOW, _RIGHT = 0.42, 0.42, 0.12  # inches: of a legend, of the last labels, of the margin
SMALL = 8.0  #: points


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """A figure in inches, without pyplot, so that the caller's matplotlib state does not change."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def gridded(rows: int, columns: int, cell: tuple[float, float], apart: tuple[float, float]) -> tuple[Figure, GridSpec]:
    """A figure with a grid of axes at fixed places, for pictures of many: to find places by letters takes seconds.

    ``cell``: width of the figure, and height of a row; ``apart``: what letters take left of axes, and below and above.
    """
    (width, tall), (beside, between) = cell, apart
    height = _LEGEND + rows * tall
    figure = new_figure(width, height, layout=None)
    wide = (width - _RIGHT - columns * beside) / columns
    grid = figure.add_gridspec(
        rows, columns, left=beside / width, right=1.0 - _RIGHT / width, bottom=_BELOW / height,
        top=1.0 - (_LEGEND + between - _BELOW) / height, wspace=beside / wide, hspace=between / (tall - between),
    )  # fmt: skip
    return figure, grid


def tidy(axes: Axes) -> None:
    """No box around, a faint grid, small letters."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL, length=2.5)


def embedded(figure: Figure) -> tuple[str, int]:
    """The figure as a data URI, and the width [CSS pixels] that shows its letters in their size."""
    content = io.BytesIO()
    figure.savefig(content, dpi=_DPI, format="png")
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode("ascii"), round(
        figure.get_figwidth() * _CSS_INCH
    )
