"""Tables of text, at most 100 columns wide."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

WIDTH = 100
EMPTY = "-"
_LABEL = 28  # characters of a label, at most

Cells = Sequence[str]


def aligned(title: str, labels: Sequence[Cells], values: Sequence[Cells], heads: int = 1) -> str:
    """Columns of cells under a wrapped title: ``labels`` to the left, ``values`` to the right.

    The first ``heads`` cells of a column are its heading. Columns of values without an entry are left out; columns that
    exceed the width continue in a second block with the same labels.
    """
    shown = [column for column in values if any(cell != EMPTY for cell in column[heads:])]
    left = [_padded([_shortened(cell) for cell in column], right=False) for column in labels]
    room = WIDTH - sum(2 + len(column[0]) for column in left)
    blocks: list[list[list[str]]] = []
    free = 0
    for column in [_padded(column, right=True) for column in shown]:
        width = 2 + len(column[0])
        if not blocks or width > free:
            blocks.append([])
            free = room
        blocks[-1].append(column)
        free -= width
    lines = textwrap.wrap(title, WIDTH)
    for block in blocks:
        lines += [("  " + "  ".join(cells)).rstrip() for cells in zip(*left, *block, strict=True)]
    return "\n".join(lines)


def number(value: float | None) -> str:
    """Three significant digits in few characters."""
    if value is None:
        return EMPTY
    if not math.isfinite(value):
        return str(value)
    if value != 0 and not 1e-4 <= abs(value) < 1e5:
        return f"{value:.2g}"
    digits = 3 if value == 0 else max(0, min(6, 2 - math.floor(math.log10(abs(value)))))
    return f"{value:.{digits}f}"


def _padded(column: Cells, right: bool) -> list[str]:
    width = max(map(len, column))
    return [cell.rjust(width) if right else cell.ljust(width) for cell in column]


def _shortened(label: str) -> str:
    """The end of a long label, which tells folders apart."""
    return label if len(label) <= _LABEL else "..." + label[-(_LABEL - 3) :]
