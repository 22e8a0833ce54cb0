"""Logs as .npz: plain arrays, never a pickle."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data import cube_tosses
from cmbrl.data.trajectories import read_trajectories
from cmbrl.errors import UserError
from cmbrl.files import atomic_path

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions

ARRAYS = ("q", "v", "u", "q_next", "v_next", "dt", "episode")


def write(data: Transitions, path: Path) -> None:
    """Writes ``data`` to ``path`` under a temporary name first; raises UserError when the place cannot be written."""
    arrays = {name: np.asarray(getattr(data, name)) for name in ARRAYS}
    for name in ("joint_names", "actuator_names"):
        if getattr(data, name):
            arrays[name] = np.asarray(getattr(data, name), dtype=np.str_)
    if data.source:
        arrays["source"] = np.asarray(json.dumps(data.source))
    with atomic_path(path) as temporary, open(temporary, "wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def read(path: Path) -> Transitions:
    """Reads transitions, plain trajectories (q, v, lengths, dt) or the published cube tosses, told apart by their keys.

    Raises UserError that names the file: not an npz, keys missing, empty, or refused by a check.
    """
    from cmbrl.data.transitions import Transitions

    try:
        with np.load(path, allow_pickle=False) as archive:
            found = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise UserError(f"{path}: not readable as npz without pickles ({error})") from None
    try:
        if cube_tosses.is_layout(found):
            data = cube_tosses.convert(found)
        elif "q" in found and "lengths" in found:
            known = ("q", "v", "u", "lengths", "dt")
            data = read_trajectories(**{name: found[name] for name in known if name in found})
        else:
            data = Transitions(**_fields(found))
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    if len(data) == 0:
        raise UserError(f"{path}: the log is empty: record at least one transition")
    return data


def _fields(found: dict[str, np.ndarray]) -> dict:
    missing = [name for name in ARRAYS if name not in found]
    if missing:
        raise UserError(
            f"no {', '.join(missing)} in the file (it holds {', '.join(sorted(found)) or 'nothing'}): a log needs "
            f"{', '.join(ARRAYS)}, or q, v, lengths and dt of trajectories"
        )
    fields: dict = {name: found[name] for name in ARRAYS}
    for name in ("joint_names", "actuator_names"):
        if name in found:
            fields[name] = tuple(found[name].tolist())
    if "source" in found:
        try:
            fields["source"] = dict(json.loads(str(found["source"])))
        except (json.JSONDecodeError, TypeError, ValueError):
            raise UserError("source is not a JSON object: remove it from the file") from None
    return fields
