"""Flat meshes, which have no hull to collide with: they become thin plates, as wide as their hull."""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial import ConvexHull

from cmbrl.scene.records import Array

THICK = 1e-3  # m
_LINE = 1e-9  # of its length, below which a mesh has no width
_REFUSED = re.compile(r"mesh '(.*?)' has coplanar vertices")
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def thicken(refused: str, meshes: dict[str, bytes], scales: dict[str, float]) -> str | None:
    """Puts a plate in the place of the mesh that MuJoCo has ``refused`` since it is flat; returns its name.

    ``scales``: by what the contents of ``meshes`` are multiplied. None: MuJoCo has said something else.
    """
    told = _REFUSED.search(refused)
    name = next((name for name in meshes if told and name.rsplit(".", 1)[0] == told[1]), None)
    points = _points(name, meshes[name]) if name else np.zeros((0, 3))
    if name is None or len(points) < 3:
        return None
    middle = points.mean(axis=0)
    _, size, (first, second, _) = np.linalg.svd(points - middle, full_matrices=False)
    if size[1] <= _LINE * size[0]:  # a line has no area
        return None
    plane = (points - middle) @ np.array([first, second]).T
    outline = middle + plane[ConvexHull(plane).vertices] @ np.array([first, second])  # counterclockwise
    up = np.cross(first, second) * 0.5 * THICK / scales.get(name, 1.0)
    del meshes[name]
    meshes[f"{told[1]}.stl" if told else name] = _prism(outline - up, outline + up)
    return name


def _points(name: str, data: bytes) -> Array:
    """Vertices (n, 3) of a binary STL or an OBJ; none of others."""
    if name.endswith(".stl"):
        return np.frombuffer(data, _STL, offset=84)["corners"].reshape(-1, 3).astype(np.float64)
    if not name.endswith(".obj"):
        return np.zeros((0, 3))
    lines = [line.split()[1:4] for line in data.decode(errors="replace").splitlines() if line.startswith("v ")]
    return np.array(lines, dtype=np.float64).reshape(-1, 3)


def _prism(low: Array, high: Array) -> bytes:
    """Binary STL of what lies between two polygons (m, 3), counterclockwise as seen from above."""
    count = len(low)
    caps = [(high[0], high[k], high[k + 1]) for k in range(1, count - 1)]
    caps += [(low[0], low[k + 1], low[k]) for k in range(1, count - 1)]
    walls = []
    for k in range(count):
        n = (k + 1) % count
        walls += [(low[k], low[n], high[n]), (low[k], high[n], high[k])]
    triangles = np.zeros(len(caps) + len(walls), _STL)
    triangles["corners"] = np.array([*caps, *walls])
    return bytes(80) + len(triangles).to_bytes(4, "little") + triangles.tobytes()
