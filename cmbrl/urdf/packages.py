"""Where the files that a URDF names lie: addresses of ROS packages, of the file system, and relative paths."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from cmbrl.errors import UserError
from cmbrl.reading import regular_file

_ROS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")  # of ROS 1, of ROS 2


def find(address: str, urdf: Path, packages: Sequence[Path] = ()) -> Path:
    """The file of ``address`` in ``urdf``: ``package://NAME/...``, ``model://NAME/...``, ``file://...`` or a path.

    A package is looked for in ``packages``, in the folders above the URDF, and where the environment of ROS says.
    Raises UserError that names the address and the remedy.
    """
    scheme, colon, rest = address.partition("://")
    if not colon:
        candidates = [urdf.parent / address]
    elif scheme == "file":
        candidates = [Path(rest)]
    else:
        candidates = _in_packages(rest.lstrip("/"), [*packages, *urdf.resolve().parents, *_of_ros()])
    for path in candidates:
        if os.path.lexists(path):
            return regular_file(path, f"named in {urdf}")
    raise UserError(
        f"{urdf}: cannot find {address}: give the folder that holds the package with --packages FOLDER, or set "
        "ROS_PACKAGE_PATH"
    )


def _in_packages(rest: str, folders: Sequence[Path]) -> list[Path]:
    """``NAME/inside`` in folders of packages, and ``inside`` in those that are the package, whatever it is called."""
    name, _, inside = rest.partition("/")
    named = [path for folder in folders for path in (folder / name / inside, folder / "share" / name / inside)]
    return [*named, *(folder / inside for folder in folders if folder.name == name), *(f / inside for f in folders)]


def _of_ros() -> list[Path]:
    return [Path(entry) for key in _ROS for entry in os.environ.get(key, "").split(os.pathsep) if entry]
