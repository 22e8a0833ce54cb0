"""The features of a geom that may touch something: points and segments with a radius, boxes; in the body frame."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import Array, Frame

_GEOM = mujoco.mjtGeom
_NAMES = {
    int(_GEOM.mjGEOM_PLANE): "plane",
    int(_GEOM.mjGEOM_SPHERE): "sphere",
    int(_GEOM.mjGEOM_CAPSULE): "capsule",
    int(_GEOM.mjGEOM_BOX): "box",
    int(_GEOM.mjGEOM_CYLINDER): "cylinder",
    int(_GEOM.mjGEOM_MESH): "mesh",
    int(_GEOM.mjGEOM_ELLIPSOID): "ellipsoid",
    int(_GEOM.mjGEOM_HFIELD): "height field",
    int(_GEOM.mjGEOM_SDF): "SDF",
}
_RIM_POINTS = 8
_HULL_POINTS = 32


@dataclass(frozen=True)
class Shape:
    """A geom in the frame of the moving body (or world) that carries it."""

    geom: int
    kind: str
    body: int
    pos: Array  # (3,)
    rot: Array  # (3, 3)
    size: Array  # (3,) as in MuJoCo: radius, half length, half sizes
    bound: float  # radius of a sphere around pos that holds it
    hull: Array  # (n, 3) points of a mesh in the geom frame, else empty

    @property
    def axis(self) -> Array:
        """Half segment vector (3,) of a capsule; zero for other shapes."""
        return self.rot[:, 2] * self.size[1] if self.kind == "capsule" else np.zeros(3)

    @property
    def radius(self) -> float:
        """What rounds the feature off: the radius of a sphere or capsule, zero for the corners of other shapes."""
        return float(self.size[0]) if self.kind in ("sphere", "capsule") else 0.0

    def reach_along(self, direction: Array) -> float:
        """Half the extent [m] along a unit direction (3,) of the body frame."""
        local = self.rot.T @ direction
        if self.kind == "sphere":
            return float(self.size[0])
        if self.kind == "capsule":
            return float(self.size[0] + self.size[1] * abs(local[2]))
        if self.kind == "box":
            return float(self.size @ np.abs(local))
        if self.kind == "cylinder":
            return float(self.size[0] * np.hypot(local[0], local[1]) + self.size[1] * abs(local[2]))
        return self.bound


def read_shape(model: mujoco.MjModel, geom: int, frames: list[Frame]) -> Shape:
    """The shape of a geom of the file, in the frame of its moving body."""
    frame = frames[model.geom_bodyid[geom]]
    kind = _NAMES.get(int(model.geom_type[geom]), "other")
    hull = hull_points(model, int(model.geom_dataid[geom])) if kind == "mesh" else np.zeros((0, 3))
    return Shape(
        geom,
        kind,
        frame.body,
        frame.pos + frame.rot @ model.geom_pos[geom],
        frame.rot @ quaternion_matrix(model.geom_quat[geom]),
        model.geom_size[geom].copy(),
        float(np.linalg.norm(hull, axis=1).max()) if len(hull) else float(model.geom_rbound[geom]),
        hull,
    )


def plane_points(shape: Shape, normal_axis: Array | None) -> list[tuple[Array, float, int]]:
    """The points (position (3,) in the body frame, radius, weight) by which a shape touches a plane.

    ``normal_axis`` (3,), in the body frame, is given for motion in a plane: a cylinder then gives the points of its
    outline in that plane (a disc or a rectangle), which are exact, instead of eight on each rim.
    """
    points: list[tuple[Array, float, int]] = []
    if shape.kind in ("sphere", "capsule"):
        ends = (-1, 1) if shape.kind == "capsule" else (0,)
        return [(shape.pos + end * shape.axis, shape.radius, 1) for end in ends]
    if shape.kind == "box":
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1), indexing="ij")).reshape(3, -1).T
        local = signs * shape.size
    elif shape.kind == "cylinder":
        radius, half = shape.size[:2]
        along = 0.0
        if normal_axis is not None:
            side = shape.rot.T @ normal_axis
            along = abs(side[2])
            if along > 1 - 1e-8:  # it rolls in the plane; MuJoCo touches with both rims
                return [(shape.pos, float(radius), 2)]
        if normal_axis is not None and along < 1e-8:
            rim = np.array([[-side[1], side[0]], [side[1], -side[0]]]) * radius
        else:
            angle = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
            rim = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        local = np.vstack([np.column_stack([rim, np.full(len(rim), end)]) for end in (-half, half)])
    else:
        local = shape.hull
    points += [(shape.pos + shape.rot @ point, 0.0, 1) for point in local]
    return points


def hull_points(model: mujoco.MjModel, mesh: int) -> Array:
    """At most 32 vertices (n, 3) of a mesh's convex hull, chosen farthest first; frame of the geom.

    The hull is the one MuJoCo keeps in ``mesh_graph`` (numvert, numface, edge addresses, vertex numbers, ...).
    """
    first = int(model.mesh_vertadr[mesh])
    points = np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=np.float64)
    graph = int(model.mesh_graphadr[mesh])
    if graph >= 0:
        count = int(model.mesh_graph[graph])
        points = points[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]
    if len(points) <= _HULL_POINTS:
        return points
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < _HULL_POINTS:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[np.sort(chosen)]
