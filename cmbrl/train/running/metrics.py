"""What a run measured, one row per iteration: a CSV file that survives kills, and TensorBoard if installed."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from cmbrl.errors import UserError
from cmbrl.files import write_text, writing
from cmbrl.train.running.event_file import EventFile

FILE = "metrics.csv"
Row = dict[str, float]


class MetricsLog:
    """``metrics.csv`` in ``folder``, and TensorBoard's event files; ``rows`` is the content of the CSV file.

    ``rows``: those of the run that is continued, up to its last checkpoint; ``append`` adds to this list. Later ones
    (written, then lost by a kill before the next checkpoint) are dropped from both. Close it at the end. Raises
    UserError where the disk is full.
    """

    def __init__(self, folder: Path, rows: list[Row]) -> None:
        self.path, self.rows = folder / FILE, rows
        self.columns = _columns(rows)
        write_text(self.path, as_csv(rows))
        with writing(folder):
            self._board = _event_file(folder, len(rows))

    def append(self, row: Mapping[str, float]) -> None:
        """Appends one row; a metric that is new in this row becomes another column."""
        self.rows.append(dict(row))
        if new := [name for name in row if name not in self.columns]:
            self.columns += new
            write_text(self.path, as_csv(self.rows))
        else:
            with writing(self.path), self.path.open("a", encoding="utf-8", newline="") as file:
                file.write(_lines(self.rows[-1:], self.columns))
        if self._board is not None:
            scalars = {k: value for k, value in row.items() if k != "iteration" and math.isfinite(value)}
            with writing(self.path.parent):
                self._board.add(int(row["iteration"]), scalars)

    def close(self) -> None:
        if self._board is not None:
            self._board.close()


def as_csv(rows: list[Row]) -> str:
    """A line of names and a line a row, empty where something was not measured."""
    columns = _columns(rows)
    return ",".join(columns) + "\n" + _lines(rows, columns)


def from_csv(text: str) -> list[Row]:
    """Inverse of ``as_csv``; a line cut short is left out. Raises ValueError for what is no number."""
    whole = text[: text.rfind("\n") + 1]
    return [{k: float(v) for k, v in row.items() if v} for row in csv.DictReader(io.StringIO(whole))]


def read_metrics(path: Path) -> list[Row]:
    """The rows of a ``metrics.csv``, each with what was measured in it; a line cut short by a kill is left out.

    Raises UserError that names the file if it is missing or holds no numbers.
    """
    try:
        return from_csv(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise UserError(f"{path}: not readable as metrics ({error}): start the run again") from None


def _columns(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _lines(rows: list[Row], columns: list[str]) -> str:
    lines = io.StringIO()
    csv.DictWriter(lines, columns, restval="", lineterminator="\n").writerows(
        {name: _number(float(value)) for name, value in row.items()} for row in rows
    )
    return lines.getvalue()


def _number(value: float) -> int | float:
    """A count without its ".0"."""
    return int(value) if value.is_integer() and abs(value) < 2**53 else value


def _event_file(folder: Path, iteration: int) -> EventFile | None:
    """TensorBoard's file of this part of the run, or None if it is not installed."""
    if find_spec("tensorboard") is None:
        return None
    return EventFile(folder, purge_step=iteration + 1 if iteration else None)
