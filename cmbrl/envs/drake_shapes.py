"""Shapes of a compiled MuJoCo robot in a Drake plant: the pairs that may touch there, with the same friction.

Drake mixes coefficients of friction as 2 a b / (a + b), MuJoCo takes the larger one, that of the geom with priority, or
that of a pair. Coefficients with MuJoCo's friction in every pair are looked for: 1/a + 1/b = 2/mu.
"""

from __future__ import annotations

import warnings
from typing import Any

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.collision.mixing import collision_pairs, mixed, pair_label
from cmbrl.scene.source.mjcf import name_of

_SLIPPERY, _ROUGH = 1e-6, 1e8  # least and largest coefficients
_OF_STILL = 30.0  # times as much as a pair of moving geoms
_MODULUS, _RESOLUTION = 1e7, 0.02  # Pa, m: pressure fields of hard plastics
_GEOM = mujoco.mjtGeom


def add_shapes(plant: Any, model: mujoco.MjModel, bodies: list[Any]) -> dict[int, Any]:
    """Adds all geoms that may touch another one to ``bodies``; returns their numbers in Drake by those in MuJoCo.

    Raises UserError for a shape that Drake has not; warns where no coefficients give every pair the file's friction.
    """
    frictions = _frictions(model)
    still = set(np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist())
    coefficients = _coefficients(frictions, still)
    _tell_other_frictions(model, frictions, coefficients)
    return {geom: _add(plant, model, bodies, geom, value) for geom, value in sorted(coefficients.items())}


def filter_pairs(graph: Any, model: mujoco.MjModel, added: dict[int, Any]) -> None:
    """Lets only those pairs touch that may in MuJoCo; ``added`` is what ``add_shapes`` returned."""
    from pydrake.geometry import CollisionFilterDeclaration, GeometrySet

    others: dict[int, list[int]] = {}
    for first, second in _frictions(model):
        others.setdefault(first, []).append(second)
    declaration = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(list(added.values())))
    for first, seconds in others.items():
        declaration.AllowBetween(GeometrySet([added[first]]), GeometrySet([added[geom] for geom in seconds]))
    graph.collision_filter_manager().Apply(declaration)


def _frictions(model: mujoco.MjModel) -> dict[tuple[int, int], float]:
    """MuJoCo's coefficient of friction by pair of geoms."""
    laws = {(first, second): mixed(model, first, second, pair) for first, second, pair in collision_pairs(model)}
    return {pair: float(law.friction[0]) if law.dim > 1 else 0.0 for pair, law in laws.items()}


def _coefficients(frictions: dict[tuple[int, int], float], still: set[int]) -> dict[int, float]:
    """A coefficient for every geom by which these ``frictions`` come out in Drake, or come near where none do so.

    Then those on ``still`` geoms count most: feet on a floor.
    """
    from scipy.optimize import nnls

    geoms = sorted({geom for pair in frictions for geom in pair})
    matrix, weight = np.zeros((len(frictions), len(geoms))), np.ones(len(frictions))
    for row, (pair, friction) in enumerate(frictions.items()):
        weight[row] = _OF_STILL if still & set(pair) else 1.0
        matrix[row, [geoms.index(geom) for geom in pair]] = weight[row] * 0.5 * max(friction, _SLIPPERY)
    smooth = nnls(matrix, weight)[0] if frictions else np.zeros(0)
    return {geom: float(1.0 / max(x, 1.0 / _ROUGH)) for geom, x in zip(geoms, smooth, strict=True)}


def _tell_other_frictions(
    model: mujoco.MjModel, frictions: dict[tuple[int, int], float], coefficients: dict[int, float]
) -> None:
    """A warning that names the pair whose friction is farthest from the file's, if it is off by a hundredth."""
    off = {pair: mixed_by_drake(*(coefficients[geom] for geom in pair)) - mu for pair, mu in frictions.items()}
    worst = max(off, key=lambda pair: abs(off[pair]), default=None)
    if worst is not None and abs(off[worst]) > 0.01 * max(frictions[worst], _SLIPPERY) + _SLIPPERY:
        warnings.warn(
            f"Drake mixes the frictions of two shapes by a rule of its own: {pair_label(model, *worst)} have "
            f"{frictions[worst] + off[worst]:.2g} there, and {frictions[worst]:.2g} in MuJoCo",
            stacklevel=2,
        )


def mixed_by_drake(one: float, other: float) -> float:
    """The friction of two shapes with these coefficients."""
    return 2 * one * other / (one + other)


def _add(plant: Any, model: mujoco.MjModel, bodies: list[Any], geom: int, friction: float) -> Any:
    from pydrake.common.eigen_geometry import Quaternion
    from pydrake.geometry import (
        AddCompliantHydroelasticProperties,
        AddContactMaterial,
        AddRigidHydroelasticProperties,
        ProximityProperties,
    )
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import CoulombFriction

    properties = ProximityProperties()
    AddContactMaterial(properties=properties, friction=CoulombFriction(friction, friction))
    kind = _GEOM(model.geom_type[geom])
    if kind == _GEOM.mjGEOM_PLANE:
        AddRigidHydroelasticProperties(properties)
    elif kind != _GEOM.mjGEOM_SPHERE:  # a sphere touches in a point
        AddCompliantHydroelasticProperties(_RESOLUTION, _MODULUS, properties)
    turn, place = model.geom_quat[geom], model.geom_pos[geom]
    pose = RigidTransform(RotationMatrix(Quaternion(turn / np.linalg.norm(turn))), place)
    body = bodies[int(model.geom_bodyid[geom])]
    return plant.RegisterCollisionGeometry(body, pose, _shape(model, geom), f"geom {geom}", properties)


def _shape(model: mujoco.MjModel, geom: int) -> Any:
    from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, HalfSpace, Sphere

    kind, size = _GEOM(model.geom_type[geom]), model.geom_size[geom]
    if kind == _GEOM.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        rows = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
        return Convex(points=model.mesh_vert[rows].T.astype(float), label=f"mesh {mesh}")
    if kind == _GEOM.mjGEOM_PLANE:
        return HalfSpace()
    if kind == _GEOM.mjGEOM_SPHERE:
        return Sphere(size[0])
    if kind == _GEOM.mjGEOM_CAPSULE:
        return Capsule(size[0], 2 * size[1])
    if kind == _GEOM.mjGEOM_CYLINDER:
        return Cylinder(size[0], 2 * size[1])
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        return Ellipsoid(*size)
    if kind == _GEOM.mjGEOM_BOX:
        return Box(*(2 * size))
    raise UserError(f"the simulator drake has no shape such as {name_of(model, 'geom', geom)}: judge it in MuJoCo")
