"""Logs as .npz: plain arrays, never a pickle."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any, cast

import numpy as np

from cmbrl.data import cube_tosses
from cmbrl.data.fields import ROWS, Fields
from cmbrl.data.stacking import stack
from cmbrl.errors import UserError
from cmbrl.files import write_bytes

ARRAYS = (*ROWS, "dt", "episode")


def write(data: Fields, path: Path) -> None:
    """Writes ``data`` to ``path``, completely or not at all; raises UserError if that is impossible."""
    values: dict[str, Any] = {**data}
    arrays = {name: np.asarray(values[name]) for name in ARRAYS}
    for name in ("joint_names", "actuator_names"):
        if values[name]:
            arrays[name] = np.asarray(values[name], dtype=np.str_)
    if data["source"]:
        arrays["source"] = np.asarray(json.dumps(data["source"]))
    content = io.BytesIO()  # a zip file on a full disk complains again when it is closed
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    write_bytes(path, content.getvalue())


def read(path: Path) -> Fields:
    """Reads transitions, trajectories (q, v, lengths, dt) or the published cube tosses, which differ by their keys.

    Raises UserError that names the file if it is not an npz, or lacks keys.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            found = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise UserError(f"{path}: not readable as npz without pickles ({error})") from None
    try:
        if cube_tosses.is_layout(found):
            return cube_tosses.convert(found)
        if "q" in found and "lengths" in found:
            known = ("q", "v", "u", "lengths", "dt")
            return stack(**{name: found[name] for name in known if name in found})
        return _fields(found)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def _fields(found: dict[str, np.ndarray]) -> Fields:
    missing = [name for name in ARRAYS if name not in found]
    if missing:
        raise UserError(
            f"no {', '.join(missing)} in the file (it has {', '.join(sorted(found)) or 'nothing'}); a log needs "
            f"{', '.join(ARRAYS)}, or q, v, lengths and dt of trajectories"
        )
    fields: dict[str, Any] = {name: found[name] for name in ARRAYS}
    for name in ("joint_names", "actuator_names"):
        if name in found:
            fields[name] = tuple(found[name].tolist())
    if "source" in found:
        try:
            fields["source"] = dict(json.loads(str(found["source"])))
        except (json.JSONDecodeError, TypeError, ValueError):
            raise UserError("source is not a JSON object; remove it from the file") from None
    return cast(Fields, fields)
