"""Chooses the reader of a path."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from cmbrl.data.importing.readers import arrays, rosbag, tables
from cmbrl.data.importing.recording import Recording
from cmbrl.errors import UserError
from cmbrl.reading import regular_file

Reader = Callable[[Path, tuple[str, ...]], list[Recording]]

SUFFIXES: dict[str, Reader] = {
    ".csv": tables.read_csv,
    ".tsv": tables.read_csv,
    ".txt": tables.read_csv,
    ".parquet": tables.read_parquet,
    ".npz": arrays.read_npz,
    ".h5": arrays.read_hdf5,
    ".hdf5": arrays.read_hdf5,
    ".pt": arrays.read_pt,
    ".mcap": rosbag.read_rosbag,
    ".db3": rosbag.read_rosbag,
    ".bag": rosbag.read_rosbag,
}


def read(path: str | os.PathLike[str], joints: tuple[str, ...] = ()) -> list[Recording]:
    """The recordings in a file or folder; ``joints`` names the columns of arrays without names.

    Raises UserError that names the path if it is missing, of another kind or damaged, or needs a library.
    """
    place = Path(path)
    if os.path.isdir(place):
        return _read_folder(place, joints)
    file = regular_file(place, "check the path")
    reader = SUFFIXES.get(file.suffix.lower())
    if reader is None:
        raise UserError(
            f"{file}: unknown format; give {', '.join(SUFFIXES)}, or the folder of a rosbag2, LeRobot or Minari log"
        )
    return reader(file, joints)


def _read_folder(folder: Path, joints: tuple[str, ...]) -> list[Recording]:
    if (folder / tables.INFO).is_file():
        return tables.read_lerobot(folder, joints)
    if (folder / "metadata.yaml").is_file():
        return rosbag.read_rosbag(folder, joints)
    for main in (folder / "data" / "main_data.hdf5", folder / "main_data.hdf5"):
        if main.is_file():
            return arrays.read_hdf5(regular_file(main), joints)
    raise UserError(
        f"{folder}: neither a rosbag2 (metadata.yaml), a LeRobot dataset (meta/info.json) nor a Minari dataset "
        "(data/main_data.hdf5); give the files in it one by one"
    )
