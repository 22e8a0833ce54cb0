"""Collision meshes of a URDF as files that MuJoCo reads: binary STL and OBJ as they are, others as binary STL.

Collada and STL as text are read here, other kinds through trimesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from cmbrl.errors import UserError
from cmbrl.urdf.collada import read_collada, read_text_stl, write_stl
from cmbrl.urdf.packages import find

_HEADER, _TRIANGLE = 84, 50  # bytes of a binary STL
_READERS = {".dae": read_collada, ".stl": read_text_stl}


def collect(robot: Element, urdf: Path, packages: Sequence[Path] = ()) -> dict[str, bytes]:
    """Contents of the meshes that ``robot`` names, by a new name that is written into it.

    MuJoCo names a mesh after its file without the folder, so that two of the same name would become one.
    """
    names: dict[Path, str] = {}
    contents: dict[str, bytes] = {}
    for mesh in robot.iter("mesh"):
        path = find(mesh.get("filename", ""), urdf, packages)
        if path not in names:
            data, suffix = _readable(path, urdf)
            names[path] = _free(path.stem, suffix, contents)
            contents[names[path]] = data
        mesh.set("filename", names[path])
    return contents


def _free(stem: str, suffix: str, taken: dict[str, bytes]) -> str:
    stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in stem)
    used, n, name = {taken_name.rsplit(".", 1)[0] for taken_name in taken}, 1, stem
    while name in used:
        n += 1
        name = f"{stem}_{n}"
    return name + suffix


def _readable(path: Path, urdf: Path) -> tuple[bytes, str]:
    """Contents and suffix of a mesh for MuJoCo."""
    data, suffix = path.read_bytes(), path.suffix.lower()
    if suffix in (".obj", ".msh") or (suffix == ".stl" and _binary(data)):
        return data, suffix
    try:
        if suffix in _READERS:
            return write_stl(_READERS[suffix](data)), ".stl"
        import trimesh

        found: Any = trimesh.load(path, force="mesh")
        return bytes(found.export(file_type="stl")), ".stl"
    except ImportError as error:
        raise UserError(
            f"{urdf}: {path.name} needs the package {error.name}, since it is neither STL, OBJ nor Collada: "
            "pip install 'cmbrl[meshes]'"
        ) from None
    except Exception as error:  # each reader has its own kinds
        raise UserError(f"{path}: cannot be read as a mesh ({error}): save it as STL or OBJ") from None


def _binary(stl: bytes) -> bool:
    """Whether an STL is binary: its length is told by its number of triangles."""
    return len(stl) >= _HEADER and len(stl) == _HEADER + _TRIANGLE * int.from_bytes(stl[80:84], "little")
