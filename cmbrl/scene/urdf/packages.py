"""Where the files that a URDF names lie: addresses of ROS packages, of the file system, and relative paths."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from cmbrl.reading import regular_file

_ROS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")  # of ROS 1, of ROS 2


def find(address: str, urdf: Path, packages: Sequence[Path] = ()) -> Path | None:
    """The file of ``address`` in ``urdf``: ``package://NAME/...``, ``model://NAME/...``, ``file://...`` or a path.

    A package is looked for in ``packages``, in the folders above the URDF, and where the environment of ROS says; a
    path from where the URDF lies, and from the folders above it. What was copied from elsewhere is found where a folder
    above the URDF has the name of one in the address. None: it is nowhere.
    """
    scheme, colon, rest = address.partition("://")
    above = list(urdf.resolve().parents)
    if not colon:
        candidates = [folder / address for folder in (urdf.parent, *packages, *above)]
    elif scheme == "file":
        candidates = [Path(rest)]
    else:
        rest = rest.lstrip("/")
        candidates = _in_packages(rest, [*packages, *above, *_of_ros()]) if "/" in rest else _beside(rest, urdf)
    parts = PurePosixPath(rest if colon else address).parts
    candidates += [
        folder.joinpath(*parts[k + 1 :]) for k in range(len(parts) - 1) for folder in above if folder.name == parts[k]
    ]
    candidates += [folder / parts[-1] for folder in packages if parts]
    found = next((path for path in candidates if os.path.lexists(path) and path.name), None)
    return None if found is None else regular_file(found, f"named in {urdf}")


def _in_packages(rest: str, folders: Sequence[Path]) -> list[Path]:
    """``NAME/inside`` in folders of packages, and ``inside`` in those that are the package, whatever it is called."""
    name, _, inside = rest.partition("/")
    named = [path for folder in folders for path in (folder / name / inside, folder / "share" / name / inside)]
    return [*named, *(folder / inside for folder in folders if folder.name == name), *(f / inside for f in folders)]


def _beside(name: str, urdf: Path) -> list[Path]:
    """A file without a folder, where its package would be: with the URDF, or in the folders that it often lies in."""
    return [urdf.parent / inside / name for inside in ("", "assets", "meshes")]


def _of_ros() -> list[Path]:
    return [Path(entry) for key in _ROS for entry in os.environ.get(key, "").split(os.pathsep) if entry]
