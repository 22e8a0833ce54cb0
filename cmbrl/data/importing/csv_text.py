"""What the text of a CSV file says: where its header is, and numbers with points or commas, or dates, in fields."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np

_COMMENT = "#"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def rows_of(text: str) -> tuple[list[list[str]], str, int]:
    """The rows that are not empty, the header first, what separates their fields, and how many lines stand before.

    Comments may stand before the header. The last of them is the header where numbers follow at once. Spaces separate
    where the first row has no commas, semicolons or tabs.
    """
    comments, rest = [], text
    while rest.startswith(_COMMENT):
        line, _, rest = rest.partition("\n")
        comments.append(line)
    first = rest.partition("\n")[0]
    delimiter = max(",;\t", key=first.count)
    if delimiter not in first:
        delimiter, rest = " ", "\n".join(line.strip() for line in rest.splitlines())
    rows = [row for row in _fields(rest, delimiter) if any(map(str.strip, row))]
    if comments and rows and only_numbers(rows[0], delimiter):
        rows.insert(0, next(iter(_fields(comments.pop().lstrip(_COMMENT).strip(), delimiter))))
    return rows, delimiter, len(comments)


def _fields(text: str, delimiter: str) -> Iterator[list[str]]:
    return csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=delimiter == " ")


def only_numbers(fields: Sequence[str], delimiter: str) -> bool:
    """Whether no field is a name."""
    return not any(np.isnan(_number(field, delimiter)) for field in fields)


def column(fields: Sequence[str], delimiter: str) -> np.ndarray:
    """Numbers (T,), or seconds since 1970 of dates; NaN where a field is neither."""
    numbers = np.array([_number(field, delimiter) for field in fields])
    return np.array([_seconds(field) for field in fields]) if np.isnan(numbers).all() else numbers


def _number(field: str, delimiter: str) -> float:
    """Where commas do not separate fields, one is a decimal point."""
    try:
        return float(field if delimiter == "," else field.replace(",", "."))
    except ValueError:
        return float("nan")


def _seconds(field: str) -> float:
    try:
        date = datetime.fromisoformat(field.strip())
    except ValueError:
        return float("nan")
    return ((date if date.tzinfo else date.replace(tzinfo=UTC)) - _EPOCH).total_seconds()
