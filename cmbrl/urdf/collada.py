"""Triangles of meshes that MuJoCo does not read: Collada (ISO 17506), and STL as text."""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

Triangles = NDArray[np.float64]  # (n, 3, 3) corners [m]
_PRIMITIVES = ("triangles", "polylist", "polygons")
_DEEP = 100  # nested nodes


def read_text_stl(data: bytes) -> Triangles:
    """The triangles of an STL as text; raises ValueError where a line is not one of a vertex."""
    lines = [line.split() for line in data.decode("utf-8", "replace").splitlines()]
    corners = [[float(x) for x in words[1:4]] for words in lines if words[:1] == ["vertex"]]
    return np.array(corners, dtype=np.float64).reshape(-1, 3, 3)


def read_collada(data: bytes) -> Triangles:
    """All geometries of the file's scene, where its nodes put them, in metres by the file's unit.

    As in ROS, ``up_axis`` turns nothing. Raises ValueError for what is no Collada or has no triangles.
    """
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise ValueError(f"no XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rsplit("}", 1)[-1]
    file = _File(root)
    parts = [triangles @ pose[:3, :3].T + pose[:3, 3] for triangles, pose in file.placed()]
    if not sum(map(len, parts)):
        raise ValueError("no triangles in its scene")
    unit = root.find("asset/unit")
    return float("1" if unit is None else unit.get("meter", "1")) * np.concatenate(parts)


def write_stl(triangles: Triangles) -> bytes:
    """As binary STL, whose normals readers find by themselves."""
    rows = np.zeros(len(triangles), dtype=[("numbers", "<f4", 12), ("more", "<u2")])
    rows["numbers"][:, 3:] = triangles.reshape(-1, 9)
    return b" " * 80 + struct.pack("<I", len(rows)) + rows.tobytes()


class _File:
    def __init__(self, root: Element) -> None:
        self.root = root
        self.by_id = {element.get("id", ""): element for element in root.iter() if element.get("id")}

    def of(self, address: str | None) -> Element:
        """The element that ``#id`` names."""
        found = self.by_id.get((address or "").lstrip("#"))
        if found is None:
            raise ValueError(f"it names {address}, which is not there")
        return found

    def placed(self) -> Iterator[tuple[Triangles, Triangles]]:
        """Triangles and pose (4, 4) of every geometry in the scene, or of all geometries where there is no scene."""
        scene = self.root.find("scene/instance_visual_scene")
        if scene is None:
            yield from ((self.triangles(g), np.eye(4)) for g in self.root.iter("geometry"))
            return
        for node in self.of(scene.get("url")).findall("node"):
            yield from self._in_node(node, np.eye(4), 0)

    def _in_node(self, node: Element, pose: Triangles, depth: int) -> Iterator[tuple[Triangles, Triangles]]:
        if depth > _DEEP:
            raise ValueError(f"its nodes are nested more than {_DEEP} deep")
        for child in node:
            if child.tag in _MOVES:
                pose = pose @ _MOVES[child.tag](_numbers(child))
            elif child.tag == "instance_geometry":
                yield self.triangles(self.of(child.get("url"))), pose
            elif child.tag in ("node", "instance_node"):
                inner = child if child.tag == "node" else self.of(child.get("url"))
                yield from self._in_node(inner, pose, depth + 1)

    def triangles(self, geometry: Element) -> Triangles:
        found = [self._of_primitive(p) for p in geometry.iter() if p.tag in _PRIMITIVES]
        return np.concatenate([np.zeros((0, 3, 3)), *found])

    def _of_primitive(self, primitive: Element) -> Triangles:
        inputs = primitive.findall("input")
        stride = 1 + max((int(entry.get("offset", "0")) for entry in inputs), default=0)
        entry = next((entry for entry in inputs if entry.get("semantic") == "VERTEX"), None)
        if entry is None:
            raise ValueError("a primitive has no VERTEX")
        points = self._positions(self.of(entry.get("source")))
        lists = [_numbers(p).astype(int)[int(entry.get("offset", "0")) :: stride] for p in primitive.findall("p")]
        counts = primitive.find("vcount")
        if primitive.tag == "triangles":
            corners = np.concatenate([np.zeros(0, dtype=int), *lists]).reshape(-1, 3)
        else:
            if counts is not None and lists:
                lists = np.split(lists[0], np.cumsum(_numbers(counts).astype(int))[:-1])
            fans = [(ring[0], ring[k], ring[k + 1]) for ring in lists for k in range(1, len(ring) - 1)]
            corners = np.array(fans, dtype=int).reshape(-1, 3)
        if corners.size and not 0 <= corners.min() <= corners.max() < len(points):
            raise ValueError("a primitive names a vertex that is not there")
        return points[corners]

    def _positions(self, vertices: Element) -> Triangles:
        """Points (n, 3) of <vertices>."""
        entry = next((entry for entry in vertices.findall("input") if entry.get("semantic") == "POSITION"), None)
        source = self.of(None if entry is None else entry.get("source"))
        numbers, accessor = source.find("float_array"), source.find("technique_common/accessor")
        if numbers is None:
            raise ValueError("its points have no <float_array>")
        stride = 3 if accessor is None else int(accessor.get("stride", "3"))
        return _numbers(numbers).reshape(-1, stride)[:, :3]


def _numbers(element: Element) -> Triangles:
    return np.array((element.text or "").split(), dtype=np.float64)


def _moved(x: Triangles) -> Triangles:
    pose = np.eye(4)
    pose[:3, 3] = x
    return pose


def _turned(x: Triangles) -> Triangles:
    """About the axis x[:3] by x[3] degrees (Rodrigues)."""
    a, angle, pose = x[:3] / np.linalg.norm(x[:3]), np.deg2rad(x[3]), np.eye(4)
    across = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    pose[:3, :3] += np.sin(angle) * across + (1 - np.cos(angle)) * across @ across
    return pose


_MOVES = {
    "matrix": lambda x: x.reshape(4, 4),
    "translate": _moved,
    "rotate": _turned,
    "scale": lambda x: np.diag([*x, 1.0]),
}
