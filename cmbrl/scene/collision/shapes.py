"""The features of a geom that may touch something, in the body frame: points and segments with a radius, boxes, rims.

Real boxes have no sharp corners, but MJCF has no rounded box. ``<numeric name="rounding:GEOM" data="R"/>`` under
``<custom>`` rounds the edges and corners of the box GEOM to R [m]; MuJoCo itself ignores it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.scene.collision.contact_records import When
from cmbrl.scene.collision.height_fields import flat_height
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import Array, Frame
from cmbrl.scene.source.mjcf import name_of

_GEOM = mujoco.mjtGeom
FIELD = "height field"  #: the kind of one with hills; a flat one is a plane
_NAMES = {
    int(_GEOM.mjGEOM_PLANE): "plane",
    int(_GEOM.mjGEOM_SPHERE): "sphere",
    int(_GEOM.mjGEOM_CAPSULE): "capsule",
    int(_GEOM.mjGEOM_BOX): "box",
    int(_GEOM.mjGEOM_CYLINDER): "cylinder",
    int(_GEOM.mjGEOM_MESH): "mesh",
    int(_GEOM.mjGEOM_ELLIPSOID): "ellipsoid",
    int(_GEOM.mjGEOM_HFIELD): FIELD,
    int(_GEOM.mjGEOM_SDF): "SDF",
}
_ROUNDING = "rounding:"
_HULL_POINTS = 32
_POINTS = 3  # of MuJoCo's, of the end of a cylinder that stands
_FEET = 4  # of each end of a cylinder, with two of MuJoCo's three points to share: the third is the rim's
_INSET = 0.9  # of the radius; so feet stay clear of the ground where the cylinder rolls


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
    sides: bool = True  # those of its hull are known: of all but meshes that MuJoCo has not kept them of

    @cached_property
    def axis(self) -> Array:
        """Half segment vector (3,) of a capsule; zero for other shapes."""
        return self.rot[:, 2] * self.size[1] if self.kind == "capsule" else np.zeros(3)

    @property
    def radius(self) -> float:
        """Radius of a sphere or capsule, or the rounding of a box."""
        return float(self.size[0]) if self.kind in ("sphere", "capsule") else self.rounding

    @cached_property
    def core(self) -> Array:
        """Half sizes (3,) of the box without its rounding."""
        return self.size - self.rounding

    @cached_property
    def corners(self) -> list[tuple[Array, Array]]:
        """Of the box, without its rounding, in the body frame: each with the way to it from the centre."""
        return [(touch.pos, touch.pos - self.pos) for touch in touches(self, None)]

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """Of the segment of a capsule."""
        return self.pos - self.axis, self.pos + self.axis

    @cached_property
    def edges(self) -> list[Shape]:
        """The twelve edges of a box as capsules without a radius, or with that of the box's rounding."""
        found = []
        for axis in range(3):
            order = [(axis + 1) % 3, (axis + 2) % 3, axis]
            turn, half = self.rot[:, order], self.core[order]
            for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                pos = self.pos + turn @ np.array([x * half[0], y * half[1], 0.0])
                size = np.array([self.rounding, half[2], 0.0])
                found.append(replace(self, kind="capsule", pos=pos, rot=turn, size=size, rounding=0.0))
        return found

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
    rot, pos = frame.rot @ quaternion_matrix(model.geom_quat[geom]), frame.pos + frame.rot @ model.geom_pos[geom]
    if (height := flat_height(model, geom)) is not None:
        kind, pos = "plane", pos + height * rot[:, 2]
    hull = hull_points(model, int(model.geom_dataid[geom])) if kind == "mesh" else np.zeros((0, 3))
    return Shape(
        geom,
        kind,
        frame.body,
        pos,
        rot,
        model.geom_size[geom].copy(),
        float(np.linalg.norm(hull, axis=1).max()) if len(hull) else float(model.geom_rbound[geom]),
        hull,
        rounding,
        kind != "mesh" or (hasattr(model, "mesh_polynum") and bool(model.mesh_polynum[model.geom_dataid[geom]])),
    )


def roundings(model: mujoco.MjModel) -> dict[int, float]:
    """Geom number -> rounding [m] from the file. Raises UserError if the geom is not a box or is too small."""
    found: dict[int, float] = {}
    geoms = {name_of(model, "geom", geom): geom for geom in range(model.ngeom)}
    for number in range(model.nnumeric):
        label = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_NUMERIC, number) or ""
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


@dataclass(frozen=True)
class Touch:
    """What of a shape touches a plane: a point with a radius, the rim about it across ``rim`` (3,), an ellipsoid."""

    pos: Array
    radius: float = 0.0
    weight: float = 1.0  # number of MuJoCo's points that it stands for
    rim: Array = field(default_factory=lambda: np.zeros(3))  # as long as the rim's radius, or the longest half axis
    oval: Array | None = None  # (3, 3) of an ellipsoid: sum of r^2 e e^T over its half axes r along e [m^2]
    arm: Array = field(default_factory=lambda: np.zeros(3))  # (3,) to the corner of a box from its centre
    turn: Array | None = None  # cosine and sine (3,) of the turn about ``rim`` from its lowest point, of another on it
    when: When = When.ALWAYS

    @property
    def reach(self) -> float:
        """How far [m] the shape extends from ``pos`` here."""
        return self.radius + float(np.linalg.norm(self.rim))


def touches(shape: Shape, normal_axis: Array | None) -> list[Touch]:
    """All with which a shape touches a plane, in the body frame.

    ``normal_axis`` (3,), in the body frame, is the normal of the plane of motion, if any. A cylinder is then its exact
    outline in that plane (a disc or a rectangle), unless it is oblique to it.
    """
    if shape.kind in ("sphere", "capsule"):
        ends = (-1, 1) if shape.kind == "capsule" else (0,)
        return [Touch(shape.pos + end * shape.axis, shape.radius) for end in ends]
    if shape.kind == "ellipsoid":
        longest = int(np.argmax(shape.size))
        oval = shape.rot @ np.diag(shape.size**2) @ shape.rot.T
        return [Touch(shape.pos, rim=shape.size[longest] * shape.rot[:, longest], oval=oval)]
    if shape.kind == "box":
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1), indexing="ij")).reshape(3, -1).T
        local = signs * shape.core
    elif shape.kind == "cylinder":
        radius, half = shape.size[:2]
        side = np.zeros(3) if normal_axis is None else shape.rot.T @ normal_axis
        if abs(side[2]) > 1 - 1e-8:  # it rolls in the plane; weight 2 because MuJoCo touches with both rims
            return [Touch(shape.pos, float(radius), 2.0)]
        if normal_axis is None or abs(side[2]) > 1e-8:
            return _round_touches(shape)
        edge = np.array([[-side[1], side[0]], [side[1], -side[0]]]) * radius
        local = np.vstack([np.column_stack([edge, np.full(2, end)]) for end in (-half, half)])
    else:
        local = shape.hull
    arms = [shape.rot @ point for point in local]
    return [Touch(shape.pos + arm, shape.radius, arm=arm if shape.kind == "box" else np.zeros(3)) for arm in arms]


def _round_touches(cylinder: Shape) -> list[Touch]:
    """Of each end the rim, on which a cylinder rolls and tips over, and the feet on which it stands.

    MuJoCo's points, the lowest of the rim and two that part it in three, run around it as the cylinder tips, which no
    step that looks ahead can follow.
    """
    radius, half = cylinder.size[:2]
    feet, turns = (_around(number) for number in (_FEET, _POINTS))
    ahead, closed = [], []
    for out in (-cylinder.rot[:, 2], cylinder.rot[:, 2]):
        centre, rim = cylinder.pos + half * out, radius * out
        ahead.append(Touch(centre, rim=rim, when=When.AHEAD))
        places = centre + _INSET * radius * feet @ cylinder.rot.T
        ahead += [Touch(place, weight=(_POINTS - 1) / _FEET, when=When.AHEAD) for place in places]
        closed += [Touch(centre, rim=rim, turn=turn, when=When.CLOSED) for turn in turns]
    return ahead + closed


def _around(number: int) -> Array:
    """Cosines and sines (number, 3) of equal shares of a turn, and zeros."""
    angle = 2 * np.pi * np.arange(number) / number
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(number)])


def hull_vertices(model: mujoco.MjModel, mesh: int) -> Array:
    """All vertices (n, 3) of a mesh's convex hull in the geom frame.

    They are in MuJoCo's ``mesh_graph``: numvert, numface, edge addresses, vertex numbers, ...
    """
    first = int(model.mesh_vertadr[mesh])
    points = np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=np.float64)
    graph = int(model.mesh_graphadr[mesh])
    if graph >= 0:
        count = int(model.mesh_graph[graph])
        points = points[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]
    return points


def hull_points(model: mujoco.MjModel, mesh: int) -> Array:
    """At most 32 of ``hull_vertices``, chosen farthest first."""
    points = hull_vertices(model, mesh)
    if len(points) <= _HULL_POINTS:
        return points
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < _HULL_POINTS:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[np.sort(chosen)]
