"""Collision meshes of a URDF as files that MuJoCo reads: binary STL and OBJ as they are.

Others become binary STL through trimesh.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from cmbrl.errors import UserError
from cmbrl.scene.source.robot_source import is_pointer
from cmbrl.scene.urdf.packages import find
from cmbrl.text import shortened

_HEADER, _TRIANGLE = 84, 50  # bytes of a binary STL
_LOOKS = ("bind_material", *(f"library_{kind}" for kind in ("materials", "effects", "images", "cameras", "lights")))
_LOOKS += ("instance_camera", "instance_light")  # of Collada


def place(robot: Element, urdf: Path, packages: Sequence[Path] = ()) -> dict[str, Path | None]:
    """Where the meshes lie that ``robot`` names, by their addresses; None: nowhere."""
    addresses = dict.fromkeys(mesh.get("filename", "") for mesh in robot.iter("mesh"))
    return {address: find(address, urdf, packages) for address in addresses}


def without_missing(robot: Element, places: Mapping[str, Path | None]) -> Iterator[str]:
    """Removes collision shapes whose mesh is nowhere; says which."""
    for link in robot.findall("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is not None and places[mesh.get("filename", "")] is None:
                link.remove(collision)
                yield f"link {link.get('name')}: the collision mesh {mesh.get('filename')} is missing and left out"


def collect(robot: Element, urdf: Path, places: Mapping[str, Path | None]) -> dict[str, bytes]:
    """Contents of the meshes that ``robot`` names, by a new name that is written into it.

    MuJoCo names a mesh after its file without the folder, so that two of the same name would become one.
    """
    used = [mesh.get("filename", "") for mesh in robot.iter("mesh")]
    if missing := [address for address in dict.fromkeys(used) if places[address] is None]:
        raise UserError(
            f"{urdf}: cannot find {len(missing)} of {len(set(used))} meshes of collisions, such as "
            f"{shortened(missing[0])}: give the folder that holds the package with `cmbrl convert --packages FOLDER`, "
            "set ROS_PACKAGE_PATH, or leave them out with --ignore missing_mesh"
        )
    names: dict[Path, str] = {}
    contents: dict[str, bytes] = {}
    for mesh in robot.iter("mesh"):
        path = places[mesh.get("filename", "")]
        assert path is not None
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
    if is_pointer(path):
        raise UserError(f"{path}: is a pointer of Git LFS: get what it stands for with `git lfs pull`")
    if suffix in (".obj", ".msh") or (suffix == ".stl" and _binary(data)):
        return data, suffix
    try:
        import trimesh

        found: Any
        if suffix == ".dae":  # where it is broken, trimesh would leave out shapes and say nothing
            found = trimesh.load(_without_looks(data), file_type="dae", force="mesh", ignore_broken=False)
        else:
            found = trimesh.load(path, force="mesh")
        if not len(found.faces):
            raise ValueError("no triangles in it")
        if found.units:  # of Collada and 3MF; its up axis turns nothing, as in ROS
            found.apply_scale(trimesh.units.unit_conversion(found.units, "meters"))
        return bytes(found.export(file_type="stl")), ".stl"
    except ImportError as error:
        raise UserError(
            f"{urdf}: {path.name} needs the package {error.name}, since it is neither binary STL nor OBJ: "
            "pip install 'cmbrl[urdf]'"
        ) from None
    except Exception as error:  # each reader has its own kinds
        raise UserError(f"{path}: cannot be read as a mesh ({error}): save it as STL or OBJ") from None


def _without_looks(collada: bytes) -> io.BytesIO:
    """Collada without materials, pictures, lights and cameras, whose faults do not matter here."""
    root = ElementTree.fromstring(collada)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag.rsplit("}", 1)[-1] in _LOOKS:
                parent.remove(child)
    return io.BytesIO(ElementTree.tostring(root))


def _binary(stl: bytes) -> bool:
    """Whether an STL is binary: its length is told by its number of triangles."""
    return len(stl) >= _HEADER and len(stl) == _HEADER + _TRIANGLE * int.from_bytes(stl[80:84], "little")
