"""Which reader or writer a path asks for: ``NAME.npz``, a Minari dataset folder, or ``minari:ID``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from cmbrl.data import npz
from cmbrl.errors import UserError
from cmbrl.files import check_writable

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions

MINARI_PREFIX = "minari:"


def save(data: Transitions, path: str | os.PathLike[str]) -> None:
    """Writes ``data``; raises UserError when the name does not tell the format or the place cannot be written."""
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
    """Raises UserError when the name does not tell the format or the place cannot be written; writes nothing.

    For callers that have long work to do before they save.
    """
    is_id = str(path).startswith(MINARI_PREFIX)
    if Path(path).suffix == ".npz" and not is_id:
        check_writable(path)
    elif is_id or Path(path).suffix == "":
        from cmbrl.data import minari_io

        minari_io.check_new(minari_io.root_path(str(path).removeprefix(MINARI_PREFIX)) if is_id else Path(path))
    else:
        raise UserError(f"{path}: unknown format: end in .npz, or name a folder or minari:ID for Minari")


def load(path: str | os.PathLike[str]) -> Transitions:
    """Reads a log; raises UserError when it is missing, of another kind, empty, or fails a check at the door."""
    if str(path).startswith(MINARI_PREFIX):
        from cmbrl.data import minari_io

        return minari_io.read(minari_io.root_path(str(path).removeprefix(MINARI_PREFIX)))
    file = Path(path)
    if not file.exists():
        raise UserError(f"{file}: no such file: record a log with `cmbrl record`, or check the path")
    if file.is_dir() or file.suffix in (".hdf5", ".h5"):
        from cmbrl.data import minari_io

        return minari_io.read(file)
    if file.suffix == ".npz":
        return npz.read(file)
    raise UserError(f"{file}: unknown format: a log is a .npz file, a Minari dataset folder, or minari:ID")
