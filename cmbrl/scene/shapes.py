"""The features of a geom that may touch something: points and segments with a radius, and boxes, in the body frame.

Real boxes have no sharp corners, but MJCF has no rounded box. ``<numeric name="rounding:GEOM" data="R"/>`` under
``<custom>`` rounds the edges and corners of the box GEOM to R [m]; MuJoCo itself ignores it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.mjcf import name_of
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
_ROUNDING = "rounding:"
_RIM_POINTS = 8
_HULL_POINTS = 32


@dataclass(frozen=True)
class Shape:
    """A geom in the frame of the moving body (or the world) that carries it."""

    geom: int
    kind: str
    body: int
    pos: Array  # (3,)
    rot: Array  # (3, 3)
    size: Array  # (3,) as in MuJoCo: radius, half length, half sizes
    bound: float  # radius of a bounding sphere around pos
    hull: Array  # (n, 3) points of a mesh in the geom frame, otherwise empty
    rounding: float = 0.0  # of a box's edges

    @property
    def axis(self) -> Array:
        """Half segment vector (3,) of a capsule; zero for other shapes."""
        return self.rot[:, 2] * self.size[1] if self.kind == "capsule" else np.zeros(3)

    @property
    def radius(self) -> float:
        """Radius of a sphere or capsule, or the rounding of a box."""
        return float(self.size[0]) if self.kind in ("sphere", "capsule") else self.rounding

    @property
    def core(self) -> Array:
        """Half sizes (3,) of the box without its rounding."""
        return self.size - self.rounding

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


def read_shape(model: mujoco.MjModel, geom: int, frames: list[Frame], rounding: float = 0.0) -> Shape:
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
        rounding,
    )


def roundings(model: mujoco.MjModel) -> dict[int, float]:
    """Geom number -> rounding [m] from the file. Raises UserError if the geom is not a box or is too small."""
    found: dict[int, float] = {}
    geoms = {name_of(model, "geom", geom): geom for geom in range(model.ngeom)}
    for number in range(model.nnumeric):
        label = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_NUMERIC, number)
        name = label.removeprefix(_ROUNDING)
        if name == label:
            continue
        if name not in geoms:
            raise UserError(f"numeric {label!r}: no such geom; {did_you_mean(name, geoms)}")
        geom = geoms[name]
        value, half = float(model.numeric_data[model.numeric_adr[number]]), float(model.geom_size[geom].min())
        if model.geom_type[geom] != _GEOM.mjGEOM_BOX:
            raise UserError(f"numeric {label!r}: only boxes can be rounded; remove it")
        if not 0.0 <= value < half:
            raise UserError(
                f"numeric {label!r} is {value:g} m; give at least 0 and less than the smallest half size, {half:g} m"
            )
        found[geom] = value
    return found


def plane_points(shape: Shape, normal_axis: Array | None) -> list[tuple[Array, float, int]]:
    """The points (position (3,) in the body frame, radius, weight) with which a shape touches a plane.

    ``normal_axis`` (3,), in the body frame, is the normal of the plane of motion, if any. A cylinder is then its exact
    outline in that plane (a disc or a rectangle) instead of eight points on each rim.
    """
    points: list[tuple[Array, float, int]] = []
    if shape.kind in ("sphere", "capsule"):
        ends = (-1, 1) if shape.kind == "capsule" else (0,)
        return [(shape.pos + end * shape.axis, shape.radius, 1) for end in ends]
    if shape.kind == "box":
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1), indexing="ij")).reshape(3, -1).T
        local = signs * shape.core
    elif shape.kind == "cylinder":
        radius, half = shape.size[:2]
        along = 0.0
        if normal_axis is not None:
            side = shape.rot.T @ normal_axis
            along = abs(side[2])
            if along > 1 - 1e-8:  # it rolls in the plane; weight 2 because MuJoCo touches with both rims
                return [(shape.pos, float(radius), 2)]
        if normal_axis is not None and along < 1e-8:
            rim = np.array([[-side[1], side[0]], [side[1], -side[0]]]) * radius
        else:
            angle = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
            rim = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        local = np.vstack([np.column_stack([rim, np.full(len(rim), end)]) for end in (-half, half)])
    else:
        local = shape.hull
    points += [(shape.pos + shape.rot @ point, shape.radius, 1) for point in local]
    return points


def hull_points(model: mujoco.MjModel, mesh: int) -> Array:
    """At most 32 vertices (n, 3) of a mesh's convex hull in the geom frame, chosen farthest first.

    The hull is in MuJoCo's ``mesh_graph``: numvert, numface, edge addresses, vertex numbers, ...
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
