"""Chooses the reader or writer of a path: ``NAME.npz``, a Minari dataset folder, or ``minari:ID``."""

from __future__ import annotations

import os
from pathlib import Path

from cmbrl.data import npz
from cmbrl.data.fields import Fields
from cmbrl.errors import UserError
from cmbrl.files import check_writable
from cmbrl.reading import regular_file

MINARI_PREFIX = "minari:"


def save(data: Fields, path: str | os.PathLike[str]) -> None:
    """Writes ``data``; raises UserError for an unknown format or a place that cannot be written."""
    check_target(path)
    if str(path).startswith(MINARI_PREFIX):
        from cmbrl.data import minari_io

        dataset_id = str(path).removeprefix(MINARI_PREFIX)
        minari_io.write(data, minari_io.root_path(dataset_id), dataset_id)
    elif Path(path).suffix == ".npz":
        npz.write(data, Path(path))
    else:
        from cmbrl.data import minari_io

        minari_io.write(data, Path(path))


def check_target(path: str | os.PathLike[str]) -> None:
    """Raises UserError for an unknown format or a place that cannot be written; writes nothing.

    For callers with long work to do before they save.
    """
    is_id = str(path).startswith(MINARI_PREFIX)
    if Path(path).suffix == ".npz" and not is_id:
        check_writable(path)
    elif is_id or Path(path).suffix == "":
        from cmbrl.data import minari_io

        minari_io.check_new(minari_io.root_path(str(path).removeprefix(MINARI_PREFIX)) if is_id else Path(path))
    else:
        raise UserError(f"{path}: unknown format; give NAME.npz, or a folder or minari:ID for Minari")


def load(path: str | os.PathLike[str]) -> Fields:
    """Reads a log; raises UserError if it is missing, of another kind or damaged."""
    if not isinstance(path, str | os.PathLike):
        raise UserError(f"a log is read from a path, not from a {type(path).__name__}")
    if str(path).startswith(MINARI_PREFIX):
        from cmbrl.data import minari_io

        return minari_io.read(minari_io.root_path(str(path).removeprefix(MINARI_PREFIX)))
    file = Path(path)
    if os.path.isdir(file):
        from cmbrl.data import minari_io

        return minari_io.read(file)
    file = regular_file(file, "check the path, or make a log by `cmbrl import` or `cmbrl record`")
    if file.suffix in (".hdf5", ".h5"):
        from cmbrl.data import minari_io

        return minari_io.read(file)
    if file.suffix == ".npz":
        return npz.read(file)
    raise UserError(
        f"{file}: unknown format; give NAME.npz, which `cmbrl import` makes of other formats, or a folder or minari:ID "
        "for Minari"
    )
