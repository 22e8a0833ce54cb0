"""Tables of results: as text that fits a terminal, and as CSV."""

from __future__ import annotations

import csv
import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

Cell = str | float | int | None  #: None: not applicable
WIDTH = 100  #: of a terminal, in characters
_KEYS, _WORDY = 45, 40  #: widest leading columns that are repeated; widest column that is not wrapped


@dataclass(frozen=True)
class Table:
    """Rows of cells under named columns, and a sentence on how to read them (units, what is better)."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    def text(self, width: int = WIDTH) -> str:
        """Aligned columns of at most ``width`` characters.

        A table that is wider continues below, its leading columns repeated; long texts are wrapped.
        """
        cells = [list(map(str, self.columns)), *([shown(x) for x in row] for row in self.rows)]
        left = [any(isinstance(row[k], str) for row in self.rows) for k in range(len(self.columns))]  # numbers right
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        keys = self._keys(widths, left)
        room = width - sum(widths[:keys]) - 2 * keys
        wordy = room if keys + 1 == len(widths) else min(_WORDY, room)
        widths = [w if k < keys else min(w, max(wordy, 8)) for k, w in enumerate(widths)]
        blocks = _blocks(widths, keys, room)
        texts = [_aligned(cells, block, widths, left) for block in blocks]
        note = textwrap.wrap(self.note, width)
        return "\n".join([*textwrap.wrap(self.title, width), "\n\n".join(texts), *note])

    def _keys(self, widths: Sequence[int], left: Sequence[bool]) -> int:
        """How many leading columns name a row: texts, as long as they are short together, and at least one."""
        keys = 1
        while keys < len(widths) and left[keys] and keys < 2 and sum(widths[: keys + 1]) <= _KEYS:
            keys += 1
        return keys if sum(widths[:keys]) <= _KEYS else 1

    def csv(self) -> str:
        """The same with full precision."""
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([self.columns, *self.rows])
        return out.getvalue()


def _blocks(widths: Sequence[int], keys: int, room: int) -> list[list[int]]:
    """Columns that stand next to each other, block by block; the first ``keys`` are in every block."""
    blocks: list[list[int]] = [[]]
    used = 0
    for k in range(keys, len(widths)):
        if blocks[-1] and used + widths[k] > room:
            blocks.append([])
            used = 0
        blocks[-1].append(k)
        used += widths[k] + 2
    return [[*range(keys), *block] for block in blocks]


def _aligned(cells: list[list[str]], columns: list[int], widths: Sequence[int], left: Sequence[bool]) -> str:
    lines = []
    for row in cells:
        wrapped = [textwrap.wrap(row[k], widths[k]) or [""] for k in columns]
        for line in range(max(map(len, wrapped))):
            parts = [text[line] if line < len(text) else "" for text in wrapped]
            lines.append(
                "  ".join(
                    part.ljust(widths[k]) if left[k] else part.rjust(widths[k])
                    for part, k in zip(parts, columns, strict=True)
                ).rstrip()
            )
    return "\n".join(lines)


def shown(x: Cell) -> str:
    """A cell as text: four digits for numbers, a dash where nothing applies."""
    if x is None:
        return "-"
    if isinstance(x, float):
        return f"{x:.4g}"
    return str(x)
