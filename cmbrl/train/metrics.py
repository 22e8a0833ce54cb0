"""What a run measured, one row per iteration: a CSV file that survives kills, and TensorBoard if installed."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from cmbrl.errors import UserError
from cmbrl.files import write_text

FILE = "metrics.csv"
Row = dict[str, float]


class MetricsLog:
    """``metrics.csv`` in ``folder``, and TensorBoard's event files; ``rows`` is the content of the CSV file.

    ``iteration`` is the one that the run continues from. Later rows (written, then lost by a kill before the next
    checkpoint) are dropped from the CSV file and from TensorBoard. Close it at the end.
    """

    def __init__(self, folder: Path, iteration: int = 0) -> None:
        self.path = folder / FILE
        self.rows = [row for row in read_metrics(self.path) if row["iteration"] <= iteration] if iteration else []
        self.columns = list(dict.fromkeys(name for row in self.rows for name in row))
        self._rewrite()
        self._board = _event_writer(folder, iteration)

    def append(self, row: Mapping[str, float]) -> None:
        """Appends one row; a metric that is new in this row becomes another column."""
        self.rows.append(dict(row))
        new = [name for name in row if name not in self.columns]
        self.columns += new
        if new:
            self._rewrite()
        else:
            with self.path.open("a", encoding="utf-8", newline="") as file:
                file.write(self._text([row]))
        if self._board is not None:
            for name, value in row.items():
                if name != "iteration" and math.isfinite(value):
                    self._board.add_scalar(name, value, int(row["iteration"]))

    def close(self) -> None:
        if self._board is not None:
            self._board.close()

    def _rewrite(self) -> None:
        write_text(self.path, ",".join(self.columns) + "\n" + self._text(self.rows))

    def _text(self, rows: list[Any]) -> str:
        lines = io.StringIO()
        csv.DictWriter(lines, self.columns, restval="", lineterminator="\n").writerows(
            {name: _number(float(value)) for name, value in row.items()} for row in rows
        )
        return lines.getvalue()


def _number(value: float) -> int | float:
    """A count without its ".0"."""
    return int(value) if value.is_integer() and abs(value) < 2**53 else value


def read_metrics(path: Path) -> list[Row]:
    """The rows of a ``metrics.csv``, each with what was measured in it; a line cut short by a kill is left out.

    Raises UserError that names the file if it is missing or holds no numbers.
    """
    try:
        text = path.read_text(encoding="utf-8")
        whole = text[: text.rfind("\n") + 1]
        return [{k: float(v) for k, v in row.items() if v} for row in csv.DictReader(io.StringIO(whole))]
    except (OSError, ValueError, AttributeError) as error:
        raise UserError(f"{path}: not readable as metrics ({error}): start the run again") from None


def _event_writer(folder: Path, iteration: int) -> Any:
    """TensorBoard's writer, or None if it is not installed."""
    if find_spec("tensorboard") is None:
        return None
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(folder), purge_step=iteration + 1 if iteration else None)  # type: ignore[no-untyped-call]
