"""Shapes of inertias as parameters that no value makes unphysical.

The second moments of a body's mass about its centre are mu B U U^T B^T, with the scale mu of its mass, B B^T those of
the file and

    U = [sqrt(d_x) t_xy t_xz; 0 sqrt(d_y) t_yz; 0 0 sqrt(d_z)].

With mass and centre of mass this is the log-Cholesky factor of the pseudo-inertia (Rucker & Wensing, RA-L 2022)
relative to the file's: ten parameters of a body, and whatever their values, mass is nowhere negative. ``d`` scales the
second moment along a principal axis, named after the nearest axis of the body; ``t`` tilts these axes. A planar body
has one moment, mu d I. The bounds of ``d`` are a body 3.2 times as wide or narrow, those of ``t`` a shear of 45 degrees
(between axes along which the body is equally wide).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.core.core_arrays import CoreArrays
from cmbrl.scene.fittable.collector import Collector
from cmbrl.scene.layout import Layout
from cmbrl.scene.records import Array, JointKind, Tree

_SCALES, _TILTS = "xyz", (("x", "y"), ("x", "z"), ("y", "z"))
_LEAST = 1e-9  # of the largest second moment: what is flatter cannot be scaled


def offer_shapes(
    tree: Tree, massive: Sequence[int], masses: Mapping[int, int], layout: Layout, P: Array, out: Collector
) -> dict[str, Any]:
    """Adds the parameters; returns the core's arrays of shapes. ``masses``: body -> parameter of its mass."""
    turning = [k for k in massive if _turns(tree, k)]
    planar = layout.dimension == 2
    shapes = [k for k in turning if not planar or P[layout.inertia(k)] > 0]
    roots = [np.diag([P[layout.inertia(k)], 1.0]) if planar else root_of(tree.bodies[k].inertia) for k in shapes]
    numbers = np.full((len(shapes), 1 if planar else 6), -1)
    for row, k in enumerate(shapes):
        for j, axis in enumerate([""] if planar else _SCALES):
            if planar or np.any(roots[row][:, j]):
                of = tree.bodies[k].name + (f":{axis}" if axis else "")
                numbers[row, j] = out.add("inertia", of, 1.0, 0.1, 10.0, "1", [], reach=2.0)
    for row, k in enumerate(shapes if not planar else ()):
        for j, (a, b) in enumerate(_TILTS):
            if np.any(roots[row][:, _SCALES.index(a)]) and np.any(roots[row][:, _SCALES.index(b)]):
                numbers[row, 3 + j] = out.add("inertia_tilt", f"{tree.bodies[k].name}:{a}{b}", 0.0, -1.0, 1.0, "1", [])
    return {
        "nshape": len(shapes),
        "shape_body": integers(shapes),
        "shape_mass": integers([masses[k] for k in shapes]),
        "shape_par": integers(numbers),
        "shape_root": doubles([root.ravel() for root in roots], (-1, layout.dimension**2)),
    }


def add_shapes(core: CoreArrays, theta: Array, P: Array) -> None:
    """Adds what the shapes at ``theta`` add to inertias in the physical vector P (in the core: load_shapes)."""
    for body, mass, numbers, root in _shapes(core):
        own = np.where(numbers >= 0, theta[numbers], [1.0] * min(3, len(numbers)) + [0.0] * (len(numbers) - 3))
        at = core.layout.inertia(body)
        if core.planar:
            P[at] += theta[mass] * (own[0] - 1.0) * root[0, 0]
            continue
        U = np.diag(np.sqrt(own[:3]))
        U[[0, 0, 1], [1, 2, 2]] = own[3:]
        E = root @ (U @ U.T - np.eye(3)) @ root.T
        I = np.trace(E) * np.eye(3) - E  # noqa: E741
        P[at : at + 6] += theta[mass] * np.array([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]])


def _shapes(core: CoreArrays) -> Iterator[tuple[int, int, np.ndarray, Array]]:
    dimension = 2 if core.planar else 3
    numbers = core.shape_par.reshape(core.nshape, 1 if core.planar else 6)
    roots = core.shape_root.reshape(-1, dimension, dimension)
    yield from zip(core.shape_body, core.shape_mass, numbers, roots, strict=True)


def _turns(tree: Tree, body: int) -> bool:
    """Whether a joint turns the body, so that its inertia matters."""
    return any(j.kind != JointKind.SLIDE for k in tree.chain(body) for j in tree.bodies[k].joints)


def root_of(inertia: Array) -> Array:
    """B (3, 3): columns along the principal axes, each in the place of the body's axis that it is nearest to."""
    moments, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    orders = [list(order) for order in permutations(range(3))]
    order = max(orders, key=lambda order: float(np.abs(np.diag(axes[:, order])).sum()))
    axes, moments = axes[:, order], moments[order]
    axes = axes * np.where(np.diag(axes) < 0, -1.0, 1.0)
    return axes * np.sqrt(np.where(moments > _LEAST * moments.max(), moments, 0.0))
