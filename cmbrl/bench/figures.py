"""Matplotlib as every study uses it: figures without pyplot, legends below, files that are whole or absent."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.files import atomic_path


def panels(rows: int, columns: int, width: float, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of ``width`` by ``height`` [inch] and its axes (rows, columns); ``options`` go to ``subplots``."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def legend_below(
    figure: Figure, axes: Iterable[Axes] | None = None, ncols: int = 4, handles: Iterable[Artist] = ()
) -> None:
    """One legend under all panels: every label of ``axes`` (default all) once, then ``handles``."""
    found: dict[str, Artist] = {}
    for one in figure.axes if axes is None else axes:
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    found |= {str(handle.get_label()): handle for handle in handles}
    if found:
        figure.legend(
            list(found.values()), list(found), loc="outside lower center", ncols=ncols, frameon=False, fontsize="small"
        )


def save(figure: Figure, path: Path, dpi: int = 150) -> None:
    """Writes ``figure`` to ``path``; its suffix is the format."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi)
