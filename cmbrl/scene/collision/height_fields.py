"""Height fields of a file: their heights, the box around them, and what of a shape may touch one.

MuJoCo splits each cell of the grid by a diagonal. Under both triangles stand prisms down to the field's base, and a
shape touches each prism by itself, at most 50 in all (``mjc_ConvexHField`` in engine_collision_convex.c). So it does in
the core: see ``field_contact.hpp``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.records import Array, LeftOut
from cmbrl.scene.source.mjcf import name_of

_GEOM = mujoco.mjtGeom
MOST = 50  #: touches of a shape and a field, MuJoCo's and the core's
#: Corners of a prism, those of the base first, and of its sides, which the core's Prism gives their places
PRISM = np.array([[x, y, z] for z in (0.0, 1.0) for x, y in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))])
PRISM_SIDES = ((3, 4, 5), (2, 1, 0), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))
# Most points with which a shape lies on a triangle, if they are not four
_OF_TRIANGLE = {_GEOM.mjGEOM_SPHERE: 1, _GEOM.mjGEOM_ELLIPSOID: 1, _GEOM.mjGEOM_CAPSULE: 2}


@dataclass(frozen=True)
class HeightField:
    """The field of a geom, in the geom's frame: rows along y, columns along x, both over -half to half."""

    half: Array  # (2,) [m] along x and y
    base: float  # [m] below the origin
    heights: Array  # (rows, columns) [m] above the origin

    @property
    def steps(self) -> Array:
        """(2,) [m] width of a cell along x and y."""
        return 2 * self.half / (np.array(self.heights.shape[::-1]) - 1)

    @property
    def corners(self) -> Array:
        """(8, 3) of the box around it, the last coordinate the fastest."""
        (x, y), low, high = self.half, -self.base, float(self.heights.max())
        return np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (low, high)])


def read_field(model: mujoco.MjModel, geom: int) -> HeightField:
    """The height field of a geom of that type; raises UserError for heights that are not finite or make no cell."""
    field = int(model.geom_dataid[geom])
    shape = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    begin = int(model.hfield_adr[field])
    x, y, top, base = (float(size) for size in model.hfield_size[field])
    data = np.asarray(model.hfield_data[begin : begin + shape[0] * shape[1]], dtype=np.float64)
    if not np.isfinite(data).all():
        raise UserError(f"hfield {name_of(model, 'hfield', field)!r}: heights are not finite: correct its elevation")
    if min(shape) < 2:
        grid = " x ".join(map(str, shape))
        raise UserError(f"hfield {name_of(model, 'hfield', field)!r}: {grid} heights make no cell: give 2 x 2 or more")
    return HeightField(np.array([x, y]), base, top * data.reshape(shape))


def flat_height(model: mujoco.MjModel, geom: int) -> float | None:
    """Of a height field without hills, as files have it whose terrain a program makes: how high [m] it is."""
    if model.geom_type[geom] != _GEOM.mjGEOM_HFIELD:
        return None
    heights = read_field(model, geom).heights
    return float(heights[0, 0]) if np.ptp(heights) == 0 else None


def most_touches(model: mujoco.MjModel, geom: int, bound: float, field: HeightField) -> int:
    """How often a geom within a sphere of radius ``bound`` [m] can touch a field."""
    across, along = np.ceil(2 * bound / field.steps) + 1
    points = _OF_TRIANGLE.get(_GEOM(int(model.geom_type[geom])), 4)
    return int(min(MOST, 2 * across * along * points))


def field_differences(model: mujoco.MjModel, geoms: Iterable[int], candidates: CandidateTable) -> Iterator[LeftOut]:
    """What of the height fields among ``geoms``, the second of candidates, is not MuJoCo's."""
    for geom in geoms:
        if model.geom_type[geom] != _GEOM.mjGEOM_HFIELD:
            continue
        name = name_of(model, "geom", geom)
        if flat_height(model, geom) is not None:
            why = (
                "flat, and taken for a plane without an edge; MuJoCo's has a contact for each triangle that is touched"
            )
            yield LeftOut("height field", name, why)
            continue
        others = np.unique(candidates.geoms[candidates.geoms[:, 1] == geom, 0])
        field, kinds = read_field(model, geom), model.geom_type[others]
        size = " x ".join(f"{step:.3g}" for step in 1e3 * field.steps)
        why = f"where rows look ahead, only the surface is touched, at most {MOST} times by a geom, the deepest first"
        yield LeftOut("height field", name, f"{why}; MuJoCo's triangles, {size} mm, have edges and sides of their own")
        if np.any(np.isin(kinds, (_GEOM.mjGEOM_BOX, _GEOM.mjGEOM_MESH))):
            why = "the shortest way out of each triangle; MuJoCo's search ends before it, unless a margin is given"
            yield LeftOut("height field", f"boxes and meshes on {name}", why)


def field_arrays(fields: Sequence[HeightField | None], prism: int) -> dict[str, Any]:
    """Of the hulls that are a field's, None for the others; ``prism``: the hull that tells a prism's sides, or -1."""
    given = [field for field in fields if field is not None]
    numbers = np.cumsum([field is not None for field in fields]) - 1
    heights = [(field.heights + field.base).ravel() for field in given]
    return {
        "nfield": len(given),
        "prism": prism,
        "hull_field": integers([k if field else -1 for k, field in zip(numbers.tolist(), fields, strict=True)]),
        "field_size": integers([field.heights.shape for field in given]),
        "field_ptr": integers(np.cumsum([0, *map(len, heights)])),
        "field_height": doubles(np.concatenate([np.zeros(0), *heights]), (-1,)),
    }
