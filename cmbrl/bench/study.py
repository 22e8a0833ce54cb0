"""What a benchmark is: a study writes pictures and tables into a folder and returns a section that says what they show.

``cmbrl bench NAME`` runs one, ``cmbrl bench all`` every one, and the report is made of the sections alone, so that a
killed run goes on with the studies that are still missing.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cmbrl.files import read_json, write_json, write_text

Progress = Callable[[float, str], object]  #: called with the share that is done, 0 to 1, and what is being done
Cell = str | float | int | None  #: None: not applicable


@dataclass(frozen=True)
class Settings:
    """How a study is run. ``quick``: a minute or so, same charts with fewer points; ``scenes``: labels, default all."""

    quick: bool = False
    seed: int = 0
    threads: int = 1
    scenes: tuple[str, ...] | None = None


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
        widths = [max(len(row[k]) for row in cells) for k in range(len(self.columns))]
        lines = ["  ".join(x.ljust(w) for x, w in zip(row, widths, strict=True)).rstrip() for row in cells]
        return "\n".join([self.title, *lines, *([self.note] if self.note else [])])

    def csv(self) -> str:
        """The same with full precision."""
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([self.columns, *self.rows])
        return out.getvalue()


@dataclass(frozen=True)
class Figure:
    """A picture in the study's folder (``file``, PNG), and what one sees in it."""

    file: str
    title: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A study's result. ``text``: what was measured, how, and what came out, in a paragraph or two; ``values``: the
    same for machines (JSON)."""

    title: str
    text: str
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    values: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Writes ``section.json`` and one CSV a table into ``folder``."""
        for k, table in enumerate(self.tables):
            write_text(folder / f"table_{k}.csv", table.csv())
        write_json(folder / "section.json", asdict(self))

    @classmethod
    def read(cls, folder: Path) -> Section:
        """What :meth:`write` wrote; raises UserError when it is not there."""
        held = read_json(folder / "section.json")
        held["tables"] = [Table(**t) for t in held["tables"]]
        held["figures"] = [Figure(**f) for f in held["figures"]]
        return cls(**held)

    def terminal(self) -> str:
        """Title, text and tables for a terminal."""
        return "\n\n".join([self.title, self.text, *(t.text() for t in self.tables)])


@dataclass(frozen=True)
class Study:
    """``run(folder, settings, progress)`` writes its pictures into ``folder`` and returns the section.

    ``summary`` is its line in ``cmbrl bench --help``; ``scenes`` the labels that ``--scene`` takes (empty: none).
    """

    name: str
    summary: str
    run: Callable[[Path, Settings, Progress], Section]
    scenes: Sequence[str] = ()


def shown(x: Cell) -> str:
    """A cell as text: four digits for numbers, a dash where nothing applies."""
    if x is None:
        return "-"
    if isinstance(x, float):
        return f"{x:.4g}"
    return str(x)
