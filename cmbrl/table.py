"""Tables of results: as text for a terminal and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

Cell = str | float | int | None  #: None: not applicable


@dataclass(frozen=True)
class Table:
    """Rows of cells under named columns, and a sentence on how to read them (units, what is better)."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    def text(self) -> str:
        """Aligned columns for a terminal."""
        cells = [list(map(str, self.columns)), *([shown(x) for x in row] for row in self.rows)]
        columns = list(zip(*cells, strict=True))
        widths = [max(map(len, column)) for column in columns]
        left = [any(isinstance(row[k], str) for row in self.rows) for k in range(len(columns))]  # numbers to the right
        lines = [
            "  ".join(x.ljust(w) if ragged else x.rjust(w) for x, w, ragged in zip(row, widths, left, strict=True))
            for row in cells
        ]
        lines = [line.rstrip() for line in lines]
        return "\n".join([self.title, *lines, *([self.note] if self.note else [])])

    def csv(self) -> str:
        """The same with full precision."""
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([self.columns, *self.rows])
        return out.getvalue()


def shown(x: Cell) -> str:
    """A cell as text: four digits for numbers, a dash where nothing applies."""
    if x is None:
        return "-"
    if isinstance(x, float):
        return f"{x:.4g}"
    return str(x)
