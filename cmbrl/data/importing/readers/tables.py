"""Readers of tables: CSV, Parquet, and LeRobot's folders of Parquet files."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.importing.readers import csv_text
from cmbrl.data.importing.recording import Recording, need, of_arrays
from cmbrl.errors import UserError
from cmbrl.files import read_json
from cmbrl.reading import regular_file
from cmbrl.scene.info.columns import counted
from cmbrl.text import shortened

_NUMBERED = re.compile(r"(?P<array>.*?[A-Za-z])[_.]?\[?(?P<number>\d+)\]?")
INFO = Path("meta") / "info.json"  #: of a LeRobot folder
VERSIONS = ("v2.0", "v2.1", "v3.0")
_FEW, _CUT = 10, 0.01  # whole rows, of fewer none is taken for lost; share of rows that may be cut


def read_csv(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """One row per sample below a header; fields that are empty or no numbers are missing samples.

    ``joints`` name columns that are numbered like an array of their length, from 0 or 1 on: ``actual_q_0`` and so on.
    """
    try:
        sheet = csv_text.sheet_of(csv_text.decoded(path.read_bytes()))
    except (OSError, ValueError, csv.Error) as error:
        raise UserError(f"{path}: not readable as CSV ({shortened(str(error), 200)})") from None
    header, rows = sheet.header, sheet.rows
    if len(rows) < 2:
        raise UserError(
            f"{path}: has {counted(len(rows), 'sample')}; give a header and a row for each of two samples or more"
        )
    if csv_text.only_numbers(header, sheet.delimiter):
        raise UserError(f"{path}: row 1 has numbers, not names; add a header that names the columns")
    _check_names(path, header)
    whole, notes = _whole(path, rows, len(header))
    columns, dates = {}, []
    for k, name in enumerate(header):
        values, dated = csv_text.column([row[k] for row in whole], sheet.delimiter)
        if name and not np.isnan(values).all():
            columns[name] = values
            dates += [name] if dated else []
    if sheet.before:
        notes = [f"{counted(sheet.before, 'line')} before the header are passed over", *notes]
    found = of_arrays(str(path), _stacked(columns, joints), {}, joints)
    return [replace(found, dates=tuple(dates), notes=tuple(notes))]


def _whole(path: Path, rows: Sequence[csv_text.Row], width: int) -> tuple[list[list[str]], list[str]]:
    """The rows with ``width`` fields, and what is said of few others: a logger that was stopped cuts its last line.

    Raises UserError where there are many.
    """
    whole = [row for _, row in rows if len(row) == width]
    cut = [(number, len(row)) for number, row in rows if len(row) != width]
    if cut and (len(whole) < _FEW or len(cut) > max(1.0, _CUT * len(rows))):
        number, fields = cut[0]
        raise UserError(f"{path}: row {number} has {fields} fields, the header {width}; repair the row")
    notes = []
    if cut and len(rows[-1][1]) != width:
        cut.pop()
        notes.append("the last line was not written to its end, and is left out")
    if cut:
        rows_cut = counted(len(cut), "row")
        notes.append(
            f"taken for lost: {rows_cut} with another number of fields than the header, the first is row {cut[0][0]}"
        )
    return whole, notes


def _stacked(columns: Mapping[str, np.ndarray], joints: tuple[str, ...]) -> dict[str, np.ndarray]:
    """``columns`` (T,), those that are numbered like the k ``joints`` as arrays (T, k)."""
    arrays: dict[str, dict[int, str]] = {}
    count = len(joints)
    for name in columns if count else ():
        if name not in joints and (numbered := _NUMBERED.fullmatch(name)):
            arrays.setdefault(numbered["array"], {})[int(numbered["number"])] = name
    found = dict(columns)
    for array, parts in arrays.items():
        if sorted(parts) in (list(range(count)), list(range(1, count + 1))):
            found[array] = np.column_stack([found.pop(parts[k]) for k in sorted(parts)])
    return found


def _check_names(path: Path, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in filter(None, names):
        if name in seen:
            raise UserError(f"{path}: two columns are called {name!r}; rename one")
        seen.add(name)


def read_parquet(path: Path, joints: tuple[str, ...]) -> list[Recording]:
    """A Parquet file: columns of numbers, or of lists of equal length."""
    found = of_arrays(str(path), parquet_columns(path), {}, joints)
    return [replace(found, dates=_dates(path))]


def _dates(path: Path) -> tuple[str, ...]:
    """Columns of dates."""
    schema = need("pyarrow.parquet", path).read_schema(path)
    return tuple(field.name for field in schema if need("pyarrow", path).types.is_timestamp(field.type))


def parquet_columns(path: Path) -> dict[str, np.ndarray]:
    """The numeric columns (T,) of a Parquet file, and columns of lists as (T, k). Missing values are NaN."""
    parquet = need("pyarrow.parquet", path)
    arrow = need("pyarrow", path)
    try:
        table = parquet.read_table(path)
        _check_names(path, table.column_names)
        found = {name: _column(arrow, table.column(name)) for name in table.column_names}
    except UserError:
        raise
    except Exception as error:  # Arrow raises kinds of its own, and OSError and ValueError, on a damaged file
        raise UserError(f"{path}: not readable as Parquet ({shortened(str(error), 200)})") from None
    return {name: array for name, array in found.items() if array is not None}


def _column(arrow: Any, column: Any) -> np.ndarray | None:
    kind = column.type
    types = arrow.types
    if types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind):
        inner = kind.value_type
        if not (types.is_floating(inner) or types.is_integer(inner)) or column.null_count:
            return None
        flat = column.combine_chunks().flatten().to_numpy(zero_copy_only=False)
        return flat.reshape(len(column), -1) if len(column) and len(flat) % len(column) == 0 else None
    if types.is_timestamp(kind):
        return column.cast(arrow.timestamp("ns")).to_numpy().astype(np.int64) * 1e-9
    if types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind):
        return column.to_numpy().astype(np.float64)
    return None


def read_lerobot(folder: Path, joints: tuple[str, ...]) -> list[Recording]:
    """A LeRobot dataset of version 2.0, 2.1 (a file an episode) or 3.0 (many in one): one recording per episode."""
    info = read_json(folder / INFO)
    features = info.get("features") if isinstance(info, dict) else None
    version = info.get("codebase_version") if isinstance(info, dict) else None
    if not isinstance(features, dict) or version not in VERSIONS:
        raise UserError(
            f"{folder / INFO}: is of version {version!r}; LeRobot datasets of {', '.join(VERSIONS)} are read"
        )
    files = sorted((folder / "data").glob("**/*.parquet"))
    if not files:
        raise UserError(f"{folder}: no Parquet files in data/; download the dataset completely")
    labels = {name: _labels(feature) for name, feature in features.items()}
    recordings = []
    for file in files:
        columns = parquet_columns(regular_file(file))
        number = columns.get("episode_index")
        if number is None or "timestamp" not in columns:
            raise UserError(f"{file}: no episode_index and timestamp; it is not a data file of LeRobot")
        kept = {name: x for name, x in columns.items() if name not in ("frame_index", "index", "task_index")}
        for episode in np.unique(number):
            rows = number == episode
            arrays = {name: array[rows] for name, array in kept.items()}
            arrays.pop("episode_index")
            found = of_arrays(f"{folder} episode {episode:.0f}", arrays, labels, joints)
            recordings.append(replace(found, tells_units=False))
    return recordings


def _labels(feature: Any) -> tuple[str, ...]:
    """Names of a feature's columns: a list, or a mapping to a list, as ``{"motors": [...]}``."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        lists = [value for value in names.values() if isinstance(value, list)]
        names = lists[0] if len(lists) == 1 else None
    return tuple(map(str, names)) if isinstance(names, list) else ()
