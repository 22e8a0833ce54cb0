"""Drag by the boxes that stand for the bodies' inertia, as in MuJoCo's inertia-box model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.forces.fluid_ellipsoids import ellipsoid_drags, has_ellipsoids
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import WORLD, Array, Tree
from cmbrl.scene.reduction import PlaneOfMotion
from cmbrl.scene.source.mjcf import name_of, passive_forces_act
from cmbrl.scene.source.support import Gate

_ALIGNED = 1e-9
_LEAST = 1e-15  # MuJoCo's smallest mass, inertia and square of a side


@dataclass(frozen=True)
class Box:
    """The box of one body of the file, welded to a moving body."""

    name: str
    body: int
    pos: Array  # (3,) of its centre in the frame of the moving body
    rot: Array  # (3, 3) its axes there, by columns
    linear: Array  # (6,) [m^3, m] drag about and along its axes by velocity and viscosity
    quadratic: Array  # (6,) [m^5, m^2] by velocity, speed and density


def read_boxes(model: mujoco.MjModel, tree: Tree, gate: Gate) -> list[Box]:
    """The boxes in the fluid of the file, if there is one; those of the world feel nothing."""
    density, viscosity = float(model.opt.density), float(model.opt.viscosity)
    if not (density > 0 or viscosity > 0) or not passive_forces_act(model):
        return []
    if gate.drops("fluid", "option", f"density {density:g}, viscosity {viscosity:g}"):
        return []
    numbers = [k for k in range(1, model.nbody) if tree.frames[k].body != WORLD and float(model.body_mass[k]) >= _LEAST]
    boxes = [k for k in numbers if not has_ellipsoids(model, k)]
    return [_box(model, tree, number) for number in boxes]


def _box(model: mujoco.MjModel, tree: Tree, number: int) -> Box:
    frame, inertia = tree.frames[number], model.body_inertia[number]
    a, b, c = sides = np.sqrt(np.maximum(_LEAST, inertia.sum() - 2 * inertia) / model.body_mass[number] * 6)
    width = sides.mean()
    return Box(
        name_of(model, "body", number),
        frame.body,
        frame.pos + frame.rot @ model.body_ipos[number],
        frame.rot @ quaternion_matrix(model.body_iquat[number]),
        np.repeat([np.pi * width**3, 3 * np.pi * width], 3),
        np.array(
            [
                *(a * (b**4 + c**4) / 64, b * (a**4 + c**4) / 64, c * (a**4 + b**4) / 64),
                *(b * c / 2, a * c / 2, a * b / 2),
            ]
        ),
    )


def drags(linear: Array, quadratic: Array, ellipsoids: Array) -> tuple[float, float]:
    """The drag at 1 m/s, per density [N m^3/kg] and per viscosity [N/(Pa s)], each body the way that it is largest.

    Of boxes, by coefficients ``linear`` and ``quadratic`` (nx, k) along their axes, and of ``ellipsoids`` (ny, 19).
    """
    viscous, blunt = ellipsoid_drags(ellipsoids.reshape(-1, 19))
    boxes = (np.max(x, axis=-1, initial=0.0).sum() for x in (quadratic, linear))
    by_density, by_viscosity = (
        float(of_boxes + more.sum()) for of_boxes, more in zip(boxes, (blunt, viscous), strict=True)
    )
    return by_density, by_viscosity


def oblique_box(tree: Tree, plane: PlaneOfMotion, boxes: list[Box]) -> str | None:
    """Why the drag needs spatial algebra, naming the first such box; None if it does not."""
    for box in boxes:
        if np.abs(_heights(tree, plane, box)).max() < 1 - _ALIGNED:
            return f"the box of {box.name} in the fluid is oblique to the plane of motion"
    return None


def _heights(tree: Tree, plane: PlaneOfMotion, box: Box) -> Array:
    """Components (3,) of the axes of a box along the normal of the plane."""
    return plane.axis @ tree.turn(box.body, box.rot)


def box_arrays(model: mujoco.MjModel, tree: Tree, boxes: list[Box], plane: PlaneOfMotion | None) -> dict[str, Any]:
    """The boxes and the wind for the core, in the plane of motion if there is one."""
    pos, rot, linear, quadratic = [], [], [], []
    for box in boxes:
        if plane is None:
            kept = list(range(6))
            rot.append(box.rot.ravel())
            pos.append(box.pos)
        else:
            normal = int(np.argmax(np.abs(_heights(tree, plane, box))))
            first, second = (k for k in range(3) if k != normal)
            kept = [normal, 3 + first, 3 + second]  # a force against a velocity does not ask for the sign of its axis
            rot.append(plane.local(tree, box.body, box.rot[:, first]))
            pos.append(plane.local(tree, box.body, box.pos))
        linear.append(box.linear[kept])
        quadratic.append(box.quadratic[kept])
    wind = np.asarray(model.opt.wind)
    D, N = (2, 3) if plane else (3, 6)
    return {
        "nbox": len(boxes),
        "wind": doubles(plane.basis @ wind if plane else wind, (-1,)),
        "box_body": integers([box.body for box in boxes]),
        "box_pos": doubles(pos, (-1, D)),
        "box_rot": doubles(rot, (-1, 2 if plane else 9)),
        "box_linear": doubles(linear, (-1, N)),
        "box_quadratic": doubles(quadratic, (-1, N)),
    }
