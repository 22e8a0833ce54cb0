"""Shapes of a compiled MuJoCo robot in a Drake plant, and the friction of each with the world.

Drake mixes coefficients of friction as 2 a b / (a + b), MuJoCo takes the larger one, or that of the geom with priority.
The world's shapes are so rough here (1e8) that half of MuJoCo's coefficient on the robot's side gives it.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.collision.mixing import collision_pairs, mixed
from cmbrl.scene.source.mjcf import name_of

_ROUGH = 1e8
_MODULUS, _RESOLUTION = 1e7, 0.02  # Pa, m: pressure fields of hard plastics
_GEOM = mujoco.mjtGeom


def add_shapes(plant: Any, graph: Any, model: mujoco.MjModel, bodies: list[Any]) -> None:
    """Adds what of ``bodies`` may touch the world, and what of the world it may touch; nothing else touches.

    Raises UserError where the robot touches a height field, or has another friction on each shape of the world.
    """
    from pydrake.geometry import CollisionFilterDeclaration, GeometrySet

    friction = _frictions(model)
    for geom in sorted({still for still, _ in friction}):
        _add(plant, model, bodies, geom, _ROUGH)
    robot = []
    for geom in sorted({moving for _, moving in friction}):
        coefficients = {found for (_, moving), found in friction.items() if moving == geom}
        if len(coefficients) > 1:
            raise UserError(
                f"{name_of(model, 'geom', geom)} has another friction on each shape of the world; the simulator drake "
                "mixes frictions in a way of its own, so judge this robot in MuJoCo"
            )
        robot.append(_add(plant, model, bodies, geom, 0.5 * coefficients.pop()))
    graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(robot)))


def _frictions(model: mujoco.MjModel) -> dict[tuple[int, int], float]:
    """MuJoCo's coefficient of friction by (geom of the world, geom of the robot)."""
    found = {}
    for first, second, pair in collision_pairs(model):
        still = [geom for geom in (first, second) if model.body_weldid[model.geom_bodyid[geom]] == 0]
        if still:
            moving = second if still[0] == first else first
            law = mixed(model, first, second, pair)
            found[still[0], moving] = float(law.friction[0]) if law.dim > 1 else 0.0
    return found


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
    elif friction == _ROUGH:
        AddRigidHydroelasticProperties(_RESOLUTION, properties)
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
