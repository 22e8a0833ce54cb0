"""What all pictures of the page share: colours, letters, and the way from a figure into the page."""

from __future__ import annotations

import base64
import io

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

LOGGED, BEFORE, AFTER, BOUND, FAINT = "#1c2126", "#d9822b", "#1f6fb5", "#b3261e", "#9aa5b0"
_CSS_INCH = 96  # pixels
_DPI = 144
SMALL = 8.0  #: points


def new_figure(width: float, height: float) -> Figure:
    """A figure in inches, without pyplot, so that the caller's matplotlib state does not change."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


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
