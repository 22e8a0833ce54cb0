"""Ellipsoids that a fluid drags and lifts: geoms with ``fluidshape="ellipsoid"``, as in MuJoCo's ellipsoid model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import WORLD, Array, Tree
from cmbrl.scene.source.mjcf import passive_forces_act

_LEAST = 1e-15  # MuJoCo's smallest mass
_SPHERE, _CAPSULE, _CYLINDER = (
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
)


@dataclass(frozen=True)
class Ellipsoid:
    """The ellipsoid of one geom, fixed to a moving body."""

    body: int
    pos: Array  # (3,) of its centre in the frame of the moving body
    rot: Array  # (3, 3) its axes there, by columns
    coefficients: Array  # (19,) in the order of the core's EllipsoidInFluid


def has_ellipsoids(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body of the file has ellipsoids in the fluid, which replace the box of its inertia."""
    geoms = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    return any(model.geom_fluid[geom, 0] > 0 for geom in geoms)


def read_ellipsoids(model: mujoco.MjModel, tree: Tree) -> list[Ellipsoid]:
    """The ellipsoids in the fluid of the file, if there is one; the world and bodies without mass feel nothing."""
    if not (model.opt.density > 0 or model.opt.viscosity > 0) or not passive_forces_act(model):
        return []
    found = []
    for geom in np.flatnonzero(model.geom_fluid[:, 0] > 0):
        body = int(model.geom_bodyid[geom])
        frame = tree.frames[body]
        if frame.body != WORLD and model.body_mass[body] >= _LEAST:
            pos = frame.pos + frame.rot @ model.geom_pos[geom]
            rot = frame.rot @ quaternion_matrix(model.geom_quat[geom])
            found.append(Ellipsoid(frame.body, pos, rot, _coefficients(model, int(geom))))
    return found


def _semiaxes(model: mujoco.MjModel, geom: int) -> Array:
    """Semiaxes (3,) [m] of the ellipsoid that has the extent of a geom."""
    kind, (first, second, _) = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _SPHERE:
        return np.repeat(first, 3)
    if kind in (_CAPSULE, _CYLINDER):
        return np.array([first, first, second + first * (kind == _CAPSULE)])
    return np.array(model.geom_size[geom])


def _coefficients(model: mujoco.MjModel, geom: int) -> Array:
    """Those that go with the density, per kg/m^3, and those that go with the viscosity, per Pa s."""
    share, blunt, slender, angular, kutta, magnus = model.geom_fluid[geom, :6]
    axes = _semiaxes(model, geom)
    least, middle, most = np.sort(axes)
    diameter = 2 * axes.mean()
    others = np.array([[axes[1], axes[2]], [axes[2], axes[0]], [axes[0], axes[1]]])
    inertia = 8 / 15 * np.pi * axes * others.max(axis=1) ** 4
    largest = 8 / 15 * np.pi * middle * most**4
    forces = share * np.concatenate(
        [
            model.geom_fluid[geom, 6:12],
            [3 * np.pi * diameter, np.pi * diameter**3],
            [blunt, slender, kutta, magnus * 4 / 3 * np.pi * least * middle * most],
            angular * inertia + slender * (largest - inertia),
        ]
    )
    return np.concatenate([forces, others.prod(axis=1) ** 2, [np.pi * most * middle]])


def ellipsoid_drags(coefficients: Array) -> tuple[Array, Array]:
    """Of ``coefficients`` (ny, 19): drag (ny,) at 1 m/s by viscosity, and the bluntest by density."""
    return coefficients[:, 6], coefficients[:, 8] * coefficients[:, 18]


def ellipsoid_arrays(ellipsoids: list[Ellipsoid]) -> dict[str, Any]:
    """The ellipsoids for the core, in space."""
    return {
        "nellipsoid": len(ellipsoids),
        "ellipsoid_body": integers([each.body for each in ellipsoids]),
        "ellipsoid_pos": doubles([each.pos for each in ellipsoids], (-1, 3)),
        "ellipsoid_rot": doubles([each.rot.ravel() for each in ellipsoids], (-1, 9)),
        "ellipsoid_coef": doubles([each.coefficients for each in ellipsoids], (-1, 19)),
    }
