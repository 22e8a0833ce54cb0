"""Edges of hulls of many vertices, along which the core climbs to the farthest one instead of looking at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from cmbrl.scene.arrays import integers
from cmbrl.scene.records import Array

_MANY = 48  # vertices from which on climbing is quicker
_CELLS = 8  # of directions, along each side of a cube around the hull; as the core has it (climb.hpp)


@dataclass(frozen=True)
class HullGraph:
    """Of each of n vertices ``neighbours``, from ``first`` (n + 1,) on; the farthest one in the middle of each cell."""

    first: np.ndarray
    neighbours: np.ndarray
    starts: np.ndarray

    @classmethod
    def of(cls, points: Array) -> HullGraph | None:
        """Of the vertices ``points`` (n, 3) of a hull; None of few, and of what is flat to the last digit."""
        if len(points) < _MANY:
            return None
        from scipy.spatial import ConvexHull, QhullError  # half a second, which most files do not need

        try:
            triangles = ConvexHull(points).simplices
        except QhullError:
            return None
        edges = np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        edges = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
        linked = np.unique(edges[:, 0])  # others lie on a side between them
        heights = (side @ points[linked].T for side in np.split(_directions(), 6))  # of scans, large arrays
        starts = linked[np.concatenate([each.argmax(axis=1) for each in heights])]
        return cls(np.cumsum([0, *np.bincount(edges[:, 0], minlength=len(points))]), edges[:, 1], starts)


def _directions() -> Array:
    """The middle of each cell (6 * cells^2, 3): along each axis, up and down, by the two coordinates that follow."""
    side = (2.0 * np.arange(_CELLS) + 1.0) / _CELLS - 1.0
    found = np.empty((6 * _CELLS**2, 3))
    for k, (axis, sign, u, w) in enumerate(product(range(3), (1.0, -1.0), side, side)):
        found[k, [axis, (axis + 1) % 3, (axis + 2) % 3]] = sign, u, w
    return found


def graph_arrays(graphs: Sequence[HullGraph | None], counts: Sequence[int]) -> dict[str, Any]:
    """For the core: of hulls with so many vertices each, one after another."""
    firsts = np.cumsum([0, *counts])
    degrees = [
        np.zeros(n, dtype=np.int64) if graph is None else np.diff(graph.first)
        for n, graph in zip(counts, graphs, strict=True)
    ]
    known = [(graph, first) for graph, first in zip(graphs, firsts, strict=False) if graph is not None]
    numbers = np.cumsum([graph is not None for graph in graphs]) - 1
    nothing = np.zeros(0, dtype=np.int64)
    return {
        "hull_graph": integers([-1 if graph is None else n for n, graph in zip(numbers, graphs, strict=True)]),
        "next_ptr": integers(np.concatenate([[0], np.cumsum(np.concatenate([nothing, *degrees]))])),
        "vertex_next": integers(np.concatenate([nothing, *(first + graph.neighbours for graph, first in known)])),
        "climb_start": integers(np.concatenate([nothing, *(first + graph.starts for graph, first in known)])),
    }
