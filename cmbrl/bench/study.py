"""What a benchmark is: a study runs jobs, draws pictures and returns a section with its tables and findings.

``cmbrl bench NAME`` runs one study and ``cmbrl bench all`` every one. The report is made of the sections alone.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cmbrl.bench import provenance
from cmbrl.bench.provenance import SECTION
from cmbrl.errors import UserError
from cmbrl.files import read_json, write_json, write_text
from cmbrl.jobs import Runner
from cmbrl.jobs.job import plain
from cmbrl.jobs.runner import Progress as Progress
from cmbrl.jobs.store import Accept
from cmbrl.table import WIDTH, Table
from cmbrl.table import Cell as Cell
from cmbrl.table import shown as shown


@dataclass(frozen=True)
class Settings:
    """How a study is run.

    quick: a minute or so, the same charts with fewer points. threads: workers, and threads of the core where it is
    measured. scenes: labels, default all. backend and accept: as in :class:`cmbrl.jobs.Runner`. robots: a file or
    folder that the study of speed measures instead of its scenes.
    """

    quick: bool = False
    seed: int = 0
    threads: int = 1
    scenes: tuple[str, ...] | None = None
    backend: str = "loky"
    accept: Accept = "exact"
    robots: str | None = None

    def chosen(self, labels: Iterable[str]) -> list[str]:
        """Those of ``labels`` that ``scenes`` names, in their order."""
        return [label for label in labels if self.scenes is None or label in self.scenes]


@dataclass(frozen=True)
class Figure:
    """A picture in the study's folder (``file``, PNG), and what one sees in it."""

    file: str
    title: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A study's result.

    text: what was measured, how, and what came out, in a paragraph or two. values: the same for machines (JSON).
    made: with which code, where and from how many seeds (:mod:`cmbrl.bench.provenance`).
    """

    title: str
    text: str
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    values: dict[str, Any] = field(default_factory=dict)
    made: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Writes ``section.json`` and one CSV a table into ``folder``."""
        for k, table in enumerate(self.tables):
            write_text(folder / f"table_{k}.csv", table.csv())
        write_json(folder / SECTION, self.to_json())

    def to_json(self) -> dict[str, Any]:
        """Plain data: numpy's numbers as Python's, what is not finite as a word, since JSON has no such numbers."""
        found: dict[str, Any] = plain(asdict(self))
        return found

    @classmethod
    def read(cls, folder: Path) -> Section:
        """What :meth:`write` wrote; raises UserError when it is not there or not of this version."""
        file = folder / SECTION
        held = read_json(file)
        try:
            held["tables"] = [Table(**t) for t in held["tables"]]
            held["figures"] = [Figure(**f) for f in held["figures"]]
            return cls(**held)
        except (KeyError, TypeError):
            raise UserError(f"{file}: of another version: remove that folder, and run the study again") from None

    def terminal(self) -> str:
        """Title, text and tables for a terminal, and where the numbers are from."""
        paragraphs = [textwrap.fill(paragraph, WIDTH) for paragraph in self.text.split("\n\n")]
        made = [textwrap.fill(provenance.line(self.made), WIDTH)] if self.made else []
        return "\n\n".join([self.title, *paragraphs, *(t.text() for t in self.tables), *made])


@dataclass(frozen=True)
class Study:
    """``run(folder, settings, runner)`` computes by ``runner``, draws into ``folder`` and returns the section.

    summary: its line in ``cmbrl bench --help``. scenes: the labels that ``--scene`` takes; none if empty.
    """

    name: str
    summary: str
    run: Callable[[Path, Settings, Runner], Section]
    scenes: Sequence[str] = ()
