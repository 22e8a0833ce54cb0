"""Logs as .npz: plain arrays, never a pickle."""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any, cast

import numpy as np

from cmbrl.data import cube_tosses
from cmbrl.data.fields import ROWS, Fields
from cmbrl.data.stacking import stack
from cmbrl.errors import UserError
from cmbrl.files import write_bytes
from cmbrl.reading import regular_file
from cmbrl.text import shortened

ARRAYS = (*ROWS, "dt", "episode")


def write(data: Fields, path: Path) -> None:
    """Writes ``data`` to ``path``, completely or not at all; raises UserError if that is impossible."""
    values: dict[str, Any] = {**data}
    arrays = {name: np.asarray(values[name]) for name in ARRAYS}
    for name in ("joint_names", "actuator_names"):
        if values[name]:
            arrays[name] = np.asarray(values[name], dtype=np.str_)
    if values["recording"].any():
        arrays["recording"] = values["recording"]
    if data["source"]:
        arrays["source"] = np.asarray(json.dumps(data["source"]))
    content = io.BytesIO()  # a zip file on a full disk complains again when it is closed
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    write_bytes(path, content.getvalue())


def read(path: Path) -> Fields:
    """Reads transitions, trajectories (q, v, lengths, dt) or the published cube tosses, which differ by their keys.

    Raises UserError that names the file if it is not an npz, does not fit into memory, or lacks keys.
    """
    found = read_arrays(path)
    try:
        if cube_tosses.is_layout(found):
            return cube_tosses.convert(found)
        if "q" in found and "lengths" in found:
            if "dt" not in found:
                raise UserError("no dt in the file; add the time between two rows in seconds")
            known = ("q", "v", "u", "lengths", "dt")
            trajectories: dict[str, Any] = {name: found[name] for name in known if name in found}
            return stack(**trajectories)
        return _fields(found)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def keys(path: str | os.PathLike[str]) -> set[str]:
    """Names of the arrays in an npz; none if it cannot be read, which its reader then tells."""
    try:
        with zipfile.ZipFile(regular_file(path)) as archive:  # to open a named pipe would wait for ever
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, ValueError, zipfile.BadZipFile):  # UserError is a ValueError
        return set()


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an npz; raises UserError that names the file if it is not one, or does not fit into memory."""
    try:
        return _arrays(path)
    except UserError:
        raise
    except MemoryError:
        raise UserError(f"{path}: has an array that does not fit into memory; is it damaged?") from None
    except Exception as error:  # zipfile, its codecs and numpy's header each raise their own kinds on a damaged file
        raise UserError(f"{path}: not readable as npz without pickles ({shortened(str(error), 200)})") from None


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of the file by name; raises whatever its readers raise."""
    if not _is_numpys(path):
        raise UserError(
            f"{path}: not readable as npz (it is no archive): save a log with numpy.savez, or `cmbrl import` it"
        )
    with np.load(path, allow_pickle=False) as archive:
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise UserError(f"{path}: a single array, not an npz; save a log with numpy.savez")
        members: Any = archive.zip
        unpacked = sum(member.file_size for member in members.infolist()) / 2**30
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
        if unpacked > memory:
            raise UserError(f"{path}: unpacks to {unpacked:.3g} GiB, more than the {memory:.3g} GiB of this machine")
        return {name: archive[name] for name in archive.files}


def _is_numpys(path: Path) -> bool:
    """Whether the file begins as an archive or as a single array does; numpy takes all else for a pickle."""
    with regular_file(path).open("rb") as file:
        return file.read(6).startswith((b"PK", b"\x93NUMPY"))


def _fields(found: dict[str, np.ndarray]) -> Fields:
    missing = [name for name in ARRAYS if name not in found]
    if missing:
        raise UserError(
            f"no {', '.join(missing)} in the file (it has {', '.join(sorted(found)) or 'nothing'}); a log needs "
            f"{', '.join(ARRAYS)}, or q, v, lengths and dt of trajectories"
        )
    fields: dict[str, Any] = {name: found[name] for name in (*ARRAYS, "recording") if name in found}
    for name in ("joint_names", "actuator_names"):
        if name in found:
            if found[name].ndim != 1 or found[name].dtype.kind != "U":
                raise UserError(f"{name} is not a list of names; save it as text, or remove it from the file")
            fields[name] = tuple(found[name].tolist())
    if "source" in found:
        fields["source"] = _source(found["source"])
    return cast(Fields, fields)


def _source(text: np.ndarray) -> dict[str, Any]:
    try:
        source = json.loads(text.item()) if text.dtype.kind == "U" and text.size == 1 else None
    except (ValueError, RecursionError):
        source = None
    if not isinstance(source, dict):
        raise UserError("source is not a JSON object; remove it from the file")
    return source
