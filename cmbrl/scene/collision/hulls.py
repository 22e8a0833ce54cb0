"""Convex shapes that may touch each other, meshes that may touch a plane: polygons of hulls, as MuJoCo keeps them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.collision.contact_records import ContactKind
from cmbrl.scene.collision.height_fields import PRISM, PRISM_SIDES, HeightField, field_arrays, read_field
from cmbrl.scene.collision.hull_graph import HullGraph, graph_arrays
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import Array, Frame, Tree

_BOX_SIDES = (  # towards +x, -x, +y and so on: signs of the corners, from MuJoCo's first one on, in the other sense
    "+++ ++- +-- +-+", "-+- -++ --+ ---", "-+- ++- +++ -++", "--+ +-+ +-- ---", "-++ +++ +-+ --+", "++- -+- --- +--",
)  # fmt: skip
_CORNERS = 4  # candidates that a pair needs to stand for the corners of a side


_MESH, _BOX = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_BOX
_KINDS = {  # as the core numbers them
    _MESH: 0,
    _BOX: 1,
    mujoco.mjtGeom.mjGEOM_SPHERE: 2,
    mujoco.mjtGeom.mjGEOM_CAPSULE: 3,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: 4,
    mujoco.mjtGeom.mjGEOM_CYLINDER: 5,
    mujoco.mjtGeom.mjGEOM_HFIELD: 6,
}


@dataclass(frozen=True)
class Hull:
    """Vertices (n, 3) and outward normals (m, 3) in the body frame, and the vertices around each of the m sides.

    Of a round shape or a height field: the corners of its box, and no sides. ``graph``: of a mesh of many vertices.
    """

    kind: int
    points: Array
    normals: Array
    sides: tuple[tuple[int, ...], ...]
    field: HeightField | None = None
    graph: HullGraph | None = None


def hull_arrays(model: mujoco.MjModel, tree: Tree, candidates: CandidateTable, count: int) -> dict[str, Any]:
    """The hulls of spatial ``candidates``, and the hull of each of all ``count`` candidates, or -1.

    Over a plane, none of a mesh whose sides this version of MuJoCo does not keep, nor of one with fewer than four
    candidates.
    """
    found: dict[int, int] = {}
    hulls: list[Hull] = []
    which, other, first = np.full((3, count), -1)

    def number(geom: int) -> int:
        if geom not in found:
            hull = _read_hull(model, geom, tree.frames[model.geom_bodyid[geom]])
            found[geom] = -1 if hull is None else len(hulls)
            hulls.extend([] if hull is None else [hull])
        return found[geom]

    points = candidates.rows(ContactKind.POINT_PLANE)
    points = points[model.geom_type[candidates.geoms[points, 0]] == _MESH]
    pairs, pair = candidates.pairs_of(points)
    enough = np.bincount(pair, minlength=len(pairs)) >= _CORNERS
    hull_of = [number(geom) if keep else -1 for geom, keep in zip(pairs[:, 0].tolist(), enough, strict=True)]
    which[points] = np.array(hull_of, dtype=np.int64)[pair]

    touching = candidates.rows(ContactKind.HULLS)
    pairs, pair = candidates.pairs_of(touching)
    of_a, of_b = np.array([[number(a), number(b)] for a, b in pairs.tolist()], dtype=np.int64).reshape(-1, 2).T
    kinds = model.geom_type[pairs]
    prism = -1
    if any(hull.field for hull in hulls):
        prism = len(hulls)
        hulls.append(Hull(_KINDS[_MESH], PRISM, np.zeros((len(PRISM_SIDES), 3)), PRISM_SIDES))
    a_first = (kinds[:, 0] < kinds[:, 1]) | ((kinds[:, 0] == kinds[:, 1]) & (pairs[:, 0] < pairs[:, 1]))
    which[touching], other[touching], first[touching] = of_a[pair], of_b[pair], a_first[pair]
    return {
        "con_hull": integers(which),
        "con_hullB": integers(other),
        "con_first": integers(first),
        "con_many": integers(np.full(count, int(_touch_in_several(model)))),
        **_flattened(hulls),
        **field_arrays([hull.field for hull in hulls], prism),
    }


def _touch_in_several(model: mujoco.MjModel) -> bool:
    """Whether sides of meshes that lie flat on each other touch in more than one point in MuJoCo."""
    off, on = mujoco.mjtDisableBit.__members__, mujoco.mjtEnableBit.__members__
    if any(model.opt.disableflags & int(off.get(name, 0)) for name in ("mjDSBL_MULTICCD", "mjDSBL_NATIVECCD")):
        return False
    return "mjDSBL_MULTICCD" in off or bool(model.opt.enableflags & int(on.get("mjENBL_MULTICCD", 0)))


def _read_hull(model: mujoco.MjModel, geom: int, frame: Frame) -> Hull | None:
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD:
        return _field_hull(model, geom, frame)
    if model.geom_type[geom] != _MESH:
        return _box_hull(model, geom, frame)
    mesh = int(model.geom_dataid[geom])
    count = int(model.mesh_polynum[mesh]) if hasattr(model, "mesh_polynum") else 0
    if not count:
        return None
    polygons = range(model.mesh_polyadr[mesh], model.mesh_polyadr[mesh] + count)
    sides = [model.mesh_polyvert[model.mesh_polyvertadr[k] :][: model.mesh_polyvertnum[k]].tolist() for k in polygons]
    used = sorted({vertex for side in sides for vertex in side})
    number = {vertex: k for k, vertex in enumerate(used)}
    turn = frame.rot @ quaternion_matrix(model.geom_quat[geom])
    vertices = np.asarray(model.mesh_vert[model.mesh_vertadr[mesh] + np.array(used)], dtype=np.float64)
    points = frame.pos + frame.rot @ model.geom_pos[geom] + vertices @ turn.T
    return Hull(
        _KINDS[_MESH],
        points,
        np.asarray(model.mesh_polynormal[polygons.start : polygons.stop], dtype=np.float64) @ turn.T,
        tuple(tuple(number[vertex] for vertex in side) for side in sides),
        graph=HullGraph.of(points),
    )


def _field_hull(model: mujoco.MjModel, geom: int, frame: Frame) -> Hull:
    """The box around a height field, and the field."""
    field, turn = read_field(model, geom), frame.rot @ quaternion_matrix(model.geom_quat[geom])
    points = frame.pos + frame.rot @ model.geom_pos[geom] + field.corners @ turn.T
    return Hull(_KINDS[mujoco.mjtGeom.mjGEOM_HFIELD], points, np.zeros((0, 3)), (), field)


def _box_hull(model: mujoco.MjModel, geom: int, frame: Frame) -> Hull:
    """Of a box, or of a round shape the corners of the box around it."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    half = {
        mujoco.mjtGeom.mjGEOM_SPHERE: size[[0, 0, 0]],
        mujoco.mjtGeom.mjGEOM_CAPSULE: np.array([size[0], size[0], size[0] + size[1]]),
        mujoco.mjtGeom.mjGEOM_CYLINDER: size[[0, 0, 1]],
    }.get(kind, size)
    turn = frame.rot @ quaternion_matrix(model.geom_quat[geom])
    corners = ["".join(signs) for signs in product("-+", repeat=3)]
    points = np.array([[1.0 if sign == "+" else -1.0 for sign in corner] for corner in corners])
    normals = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1, -1)]
    sides = tuple(tuple(corners.index(corner) for corner in reversed(side.split())) for side in _BOX_SIDES)
    return Hull(
        _KINDS[kind],
        frame.pos + frame.rot @ model.geom_pos[geom] + (points * half) @ turn.T,
        np.array(normals) @ turn.T if kind == _BOX else np.zeros((0, 3)),
        sides if kind == _BOX else (),
    )


def _flattened(hulls: Sequence[Hull]) -> dict[str, Any]:
    firsts = np.cumsum([0, *(len(hull.points) for hull in hulls)])
    lengths = [len(side) for hull in hulls for side in hull.sides]
    shifts = np.repeat(firsts[:-1], [sum(map(len, hull.sides)) for hull in hulls])
    vertices = shifts + np.fromiter((k for hull in hulls for side in hull.sides for k in side), dtype=np.int64)
    by_vertex = np.argsort(vertices, kind="stable")
    return {
        "nhull": len(hulls),
        "nface": len(lengths),
        "hull_kind": integers([hull.kind for hull in hulls]),
        "hull_ptr": integers(firsts),
        "hull_point": doubles(np.concatenate([np.zeros((0, 3)), *(hull.points for hull in hulls)]), (-1, 3)),
        "vertex_ptr": integers(np.cumsum([0, *np.bincount(vertices, minlength=firsts[-1])])),
        "vertex_face": integers(np.repeat(np.arange(len(lengths)), lengths)[by_vertex]),
        "face_ptr": integers(np.cumsum([0, *lengths])),
        "face_vertex": integers(vertices),
        "face_normal": doubles(np.concatenate([np.zeros((0, 3)), *(hull.normals for hull in hulls)]), (-1, 3)),
        **graph_arrays([hull.graph for hull in hulls], [len(hull.points) for hull in hulls]),
    }
