"""What the text of a CSV file says: where its header is, which rows it has, and numbers or dates in fields."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from cmbrl.data.importing.columns.named_units import is_unit, split

_COMMENT = "#"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DAY = 86400.0  # [s]
_OF_DAY = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")  # the time of a clock without a date
_DAY_FIRST = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})[ T]+(.+)")
_MARKS = (b"\xff\xfe", b"\xfe\xff")  # of UTF-16

Row = tuple[int, list[str]]  #: number of the line in the file, and its fields


@dataclass(frozen=True)
class Sheet:
    """A ``header`` (k,) and ``rows`` of fields, and how many lines ``before`` the header are no comments."""

    header: list[str]
    rows: list[Row]
    delimiter: str
    before: int = 0


def decoded(content: bytes) -> str:
    """Text in UTF-8, in UTF-16 where it is marked so, or else as Windows writes western languages.

    Raises ValueError for what is no text.
    """
    if content.startswith(_MARKS):
        return content.decode("utf-16")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252")
    if "\0" in text:
        raise ValueError("it holds bytes that are no text")
    return text


def sheet_of(text: str) -> Sheet:
    """The header and the rows of ``text`` that are not empty.

    Comments may stand anywhere; the last of those before all rows is the header where numbers follow at once. Lines
    that a logger writes before the header, with another number of fields, are passed over. A row of units below the
    header goes into its names. Spaces separate where the first line has no commas, semicolons or tabs.
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    comments: list[str] = []
    for k, line in enumerate(lines):
        if line.startswith(_COMMENT):
            comments += [line] if not any(map(str.strip, lines[:k])) else []
            lines[k] = ""
    first = next((line for line in lines if line.strip()), "")
    usual = max(",;\t", key=first.count)
    order = [usual if usual in first else " ", *",;\t"]
    sheets = (_sheet(lines, comments, delimiter) for delimiter in dict.fromkeys(order))
    return next((sheet for sheet in sheets if sheet is not None), None) or _plain(lines, order[0])


def _sheet(lines: Sequence[str], comments: Sequence[str], delimiter: str) -> Sheet | None:
    """None where no row of names has as many fields as most rows have."""
    rows = _rows(lines, delimiter)
    if not rows:
        return None
    width = Counter(len(row) for _, row in rows).most_common(1)[0][0]
    if comments and only_numbers(rows[0][1], delimiter):
        told = next(_fields([comments[-1].lstrip(_COMMENT).strip()], delimiter))[1]
        return _named(told, rows, delimiter, 0) if len(told) == width else None
    for k, (_, header) in enumerate(rows):
        names = list(header)
        if len(names) == width + 1 and not names[-1].strip():
            names.pop()
        elif len(names) == width - 1 and all(not row[-1].strip() for _, row in rows[k + 1 :] if len(row) == width):
            rows = [(n, row[:-1] if len(row) == width else row) for n, row in rows]
        elif len(names) != width:
            continue
        return None if only_numbers(names, delimiter) and k else _named(names, rows[k + 1 :], delimiter, k)
    return None


def _named(header: list[str], rows: list[Row], delimiter: str, before: int) -> Sheet:
    """With the units of a row of them below the header in its names."""
    names = [name.strip() for name in header]
    below = [field.strip() for field in rows[0][1]] if rows and len(rows[0][1]) == len(names) else []
    if any(below) and all(not field or is_unit(field) for field in below):
        told = [field.strip("[]()") for field in below]
        names = [f"{x} [{u}]" if u and split(x)[1] is None else x for x, u in zip(names, told, strict=True)]
        rows = rows[1:]
    return Sheet(names, rows, delimiter, before)


def _plain(lines: Sequence[str], delimiter: str) -> Sheet:
    rows = _rows(lines, delimiter) or [(1, [])]
    return Sheet([name.strip() for name in rows[0][1]], rows[1:], delimiter)


def _rows(lines: Sequence[str], delimiter: str) -> list[Row]:
    return [(number, row) for number, row in _fields(lines, delimiter) if any(map(str.strip, row))]


def _fields(lines: Sequence[str], delimiter: str) -> Iterator[Row]:
    spaces = delimiter == " "
    text = "\n".join(line.strip() for line in lines) if spaces else "\n".join(lines)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=spaces)
    return ((reader.line_num, row) for row in reader)


def only_numbers(fields: Sequence[str], delimiter: str) -> bool:
    """Whether no field is a name."""
    return not any(np.isnan(_number(field, delimiter)) for field in fields)


def column(fields: Sequence[str], delimiter: str) -> tuple[np.ndarray, bool]:
    """Numbers (T,), or seconds since 1970 of dates, or since midnight; NaN where a field is neither. Whether dates."""
    numbers = np.array([_number(field, delimiter) for field in fields])
    if not np.isnan(numbers).all():
        return numbers, False
    dates = np.array([_seconds(field.strip()) for field in fields])
    if not np.isnan(dates).all():
        return dates, True
    clock = np.array([_of_day(field.strip()) for field in fields])
    known = np.flatnonzero(np.isfinite(clock))
    clock[known] = np.unwrap(clock[known], period=_DAY)
    return clock, bool(len(known))


def _number(field: str, delimiter: str) -> float:
    """Where commas do not separate fields, one is a decimal point."""
    try:
        return float(field if delimiter == "," else field.replace(",", "."))
    except ValueError:
        return float("nan")


def _seconds(field: str) -> float:
    """Of a date as ISO 8601 has it, or with the day first and points between, as 31.12.2026 23:59:59,5."""
    if parts := _DAY_FIRST.fullmatch(field):
        day, month, year, time = parts.groups()
        field = f"{year}-{month:0>2}-{day:0>2} {time}"
    try:
        date = datetime.fromisoformat(field)
    except ValueError:
        return float("nan")
    return ((date if date.tzinfo else date.replace(tzinfo=UTC)) - _EPOCH).total_seconds()


def _of_day(field: str) -> float:
    parts = _OF_DAY.fullmatch(field)
    if parts is None:
        return float("nan")
    hours, minutes, seconds = parts.groups()
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds.replace(",", "."))
