"""How inertia softens rows: MuJoCo's compliances grow with inverse weights, which masses and armatures determine.

MuJoCo takes the weights of qpos0: of a body tr(J M^-1 J^T) / 3 with the Jacobian J (3, nv) of its centre of mass, of a
joint the mean of its entries of the diagonal of M^-1, of a tendon J M^-1 J^T with the slope J (nv,) of its length. The
core computes them again wherever parameters move inertia (``native/step/load_weights.hpp``); rows take the ratio to
the file's. Of bodies that are welded together, each keeps its place about the centre of mass of the whole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.core.core_arrays import CoreArrays, Integers
from cmbrl.scene.layout import Layout
from cmbrl.scene.records import WORLD, Array, Tree
from cmbrl.scene.reduction import PlaneOfMotion

_NOTHING = 1e-15  # below it MuJoCo takes a weight for zero
_STEP = 1e-6  # [m, rad] of central differences
SOFTENED_LAWS = ("mujoco", "logistic")  #: whose compliance is a multiple of the inverse weight


def weight_arrays(
    model: mujoco.MjModel,
    tree: Tree,
    plane: PlaneOfMotion | None,
    candidates: CandidateTable,
    limits: Mapping[str, Any],
    P: Array,
    ptr: Array,
    idx: Array,
    shapes: Mapping[str, Any],
    layout: Layout,
    contact_law: str,
    tendons: Sequence[int],
) -> dict[str, Any]:
    """The core's arrays: the weights of joints and tendons, and of bodies that touch, and what they depend on.

    ``limits``: the core's arrays of lines; ``P`` (nP,): the nominal vector; ``ptr``, ``idx``: its places that each
    parameter moves; ``shapes``: the core's arrays of those of inertias; ``tendons``: numbers in the file of those among
    the lines.
    """
    slopes = _slopes_of_tendons(model, tendons)
    armatures = np.array([layout.dof(line) for line in range(model.nv + len(slopes))], dtype=int)
    reflecting = (P[armatures] != 0.0) | np.isin(armatures, idx)
    trees = _trees(tree, slopes[reflecting[model.nv :]])
    of_lines = [*trees.tolist(), *trees[np.argmax(slopes != 0.0, axis=1)].tolist()]
    parameters, owners = _inertial(tree, ptr, idx, shapes, layout, trees, dict(zip(armatures, of_lines, strict=True)))
    inverse = _InverseMass(model, tree, trees, P[armatures], slopes)
    found = _Weights(model, tree, plane, inverse, owners)
    lines = np.full(model.nv + len(limits["tendon_ptr"]) - 1, -1)
    for joint in tree.joints:
        if model.jnt_type[joint.source] != mujoco.mjtJoint.mjJNT_FREE:
            rows = np.zeros((len(joint.dofs), model.nv))
            rows[range(len(joint.dofs)), list(joint.dofs)] = 1.0
            lines[list(joint.dofs)] = found.of_rows(rows)
    lines[model.nv : model.nv + len(slopes)] = [found.of_rows(slope[None]) for slope in slopes]
    sides = model.geom_bodyid[candidates.geoms]
    of_body = np.full(model.nbody, -1)
    for body in np.unique(sides) if contact_law in SOFTENED_LAWS else ():
        if tree.frames[body].body != WORLD:
            of_body[body] = found.of_body(int(body))
    weights = model.body_invweight0[sides, 0]
    total = weights.sum(axis=1, keepdims=True)
    return {
        **found.arrays(),
        "inertial_par": parameters,
        "ninertial": len(parameters),
        "q0": np.array(model.qpos0, dtype=np.float64),
        "con_weight": integers(of_body[sides]),
        "con_share": doubles(weights / np.where(total > 0, total, 1.0), (-1, 2)),
        "lim_weight": integers(lines[limits["lim_line"]]),
        "line_weight": integers(lines),
    }


def _trees(tree: Tree, reflecting: Array) -> Integers:
    """The tree of each degree of freedom (nv,); lines whose slopes (n, nv) are ``reflecting`` inertia tie theirs."""
    roots: list[int] = []
    for k, body in enumerate(tree.bodies):
        roots.append(k if body.parent == WORLD else roots[body.parent])
    trees = np.array([roots[joint.body] for joint in tree.joints for _ in joint.dofs], dtype=np.int32)
    for slope in reflecting:
        tied = np.unique(trees[slope != 0.0])
        trees[np.isin(trees, tied)] = tied.min()
    return trees


def _inertial(
    tree: Tree,
    ptr: Array,
    idx: Array,
    shapes: Mapping[str, Any],
    layout: Layout,
    trees: Integers,
    reflecting: Mapping[int, int],
) -> tuple[Integers, Integers]:
    """Numbers of the parameters that move inertia, of bodies and armatures, and their trees, in the order of these.

    ``reflecting``: the trees of armatures by their places in P.
    """
    of_body = [int(trees[body.joints[0].dofs[0]]) for body in tree.bodies]
    found = {}
    for k, (begin, end) in enumerate(pairwise(ptr)):
        for place in idx[begin:end].tolist():
            if place < layout.dof(0):
                found[k] = of_body[place // layout.body_fields]
            elif place in reflecting:
                found[k] = reflecting[place]
    kinds = shapes["shape_par"].reshape(-1, 1 if layout.dimension == 2 else 6)
    for body, numbers in zip(shapes["shape_body"].tolist(), kinds.tolist(), strict=True):
        found |= dict.fromkeys((k for k in numbers if k >= 0), of_body[body])
    order = sorted(found, key=lambda k: (found[k], k))
    return integers(order), integers([found[k] for k in order])


class _InverseMass:
    """The inverse of the mass matrix at qpos0, tree by tree: of many bodies, most of it is 0."""

    def __init__(self, model: mujoco.MjModel, tree: Tree, trees: Integers, armatures: Array, slopes: Array) -> None:
        """``trees`` (nv,) of dofs; ``armatures`` (nv + nt,) of these and of tendons, whose ``slopes`` are (nt, nv)."""
        self.model, self.trees = model, trees
        self._armatures, self._slopes = armatures, slopes
        first = [body.joints[0].dofs[0] for body in tree.bodies]
        self._bodies: dict[int, list[int]] = {}
        for body, frame in enumerate(tree.frames):
            if frame.body != WORLD:
                self._bodies.setdefault(int(trees[first[frame.body]]), []).append(body)
        self._known: dict[int, tuple[Integers, Array]] = {}
        self._data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        mujoco.mj_comPos(model, self._data)

    def jacobian(self, body: int) -> Array:
        """(6, nv) of the centre of mass of a body of the file."""
        J = np.zeros((6, self.model.nv))
        mujoco.mj_jacBodyCom(self.model, self._data, J[:3], J[3:], body)
        return J

    def weight(self, J: Array) -> tuple[float, Integers]:
        """tr(J M^-1 J^T) of rows ``J`` (m, nv), and the trees that these move."""
        moved, total = np.unique(self.trees[J.any(axis=0)]), 0.0
        for label in moved.tolist():
            dofs, inverse = self._known.get(label) or self._known.setdefault(label, self._of_tree(label))
            total += float(np.sum((J[:, dofs] @ inverse) * J[:, dofs]))
        return total, moved

    def _of_tree(self, label: int) -> tuple[Integers, Array]:
        dofs = integers(np.flatnonzero(self.trees == label))
        own = self._slopes[:, dofs]
        mass = np.diag(self._armatures[dofs]) + (own.T * self._armatures[self.model.nv :]) @ own
        for body in self._bodies[label]:
            J, axes = self.jacobian(body)[:, dofs], self._data.ximat[body].reshape(3, 3)
            turned = axes.T @ J[3:]
            mass += self.model.body_mass[body] * J[:3].T @ J[:3]
            mass += turned.T @ (self.model.body_inertia[body][:, None] * turned)
        return dofs, np.asarray(np.linalg.pinv(mass, hermitian=True), dtype=np.float64)


class _Weights:
    """Weights of the file, by what the core needs to compute them: a body and a point of it, or rows J."""

    def __init__(
        self, model: mujoco.MjModel, tree: Tree, plane: PlaneOfMotion | None, inverse: _InverseMass, owners: Integers
    ) -> None:
        """``owners``: trees of parameters, rising."""
        self.model, self.tree, self.plane = model, tree, plane
        self.inverse, self.owners = inverse, owners
        self._spans: list[tuple[int, int]] = []
        self._bodies: list[int] = []
        self._points: list[Array] = []
        self._carried: list[bool] = []
        self._rows: list[Array] = []
        self._values: list[float] = []

    def of_rows(self, J: Array) -> int:
        """The number of the weight of rows J (m, nv); -1: MuJoCo takes it for zero."""
        return self._add(WORLD, np.zeros(3), False, J, J)

    def of_body(self, body: int) -> int:
        """The number of the weight of a body of the file."""
        frame, carried = self.tree.frames[body], bool(self.model.body_mass[body] > 0)
        point = frame.pos + frame.rot @ self.model.body_ipos[body]
        if carried:
            point = point - self.tree.bodies[frame.body].com
        return self._add(frame.body, point, carried, self.inverse.jacobian(body)[:3], np.empty((0, self.model.nv)))

    def _add(self, body: int, point: Array, carried: bool, J: Array, rows: Array) -> int:
        value, trees = self.inverse.weight(J)
        if value < _NOTHING:
            return -1
        self._bodies.append(body)
        self._points.append(self.plane.local(self.tree, body, point) if self.plane else point)
        self._carried.append(carried)
        self._rows.append(rows)
        self._values.append(value)
        first, last = np.searchsorted(self.owners, trees.min()), np.searchsorted(self.owners, trees.max(), "right")
        self._spans.append((int(first), int(last)))  # of tendons: of several trees, and those between them
        return len(self._values) - 1

    def arrays(self) -> dict[str, Any]:
        rows = np.concatenate([np.empty((0, self.model.nv)), *self._rows])
        of_row, dofs = np.nonzero(rows)
        return {
            "nweight": len(self._values),
            "weight_body": integers(self._bodies),
            "weight_point": doubles(self._points, (-1, 2 if self.plane else 3)),
            "weight_carried": integers(self._carried),
            "weight_nominal": doubles(self._values, (-1,)),
            "weight_span": integers(self._spans),
            "weight_slopes": integers(np.cumsum([0, *(end - begin for begin, end in self._spans)])),
            "weight_ptr": integers(np.cumsum([0, *map(len, self._rows)])),
            "weight_row_ptr": integers(np.cumsum([0, *np.bincount(of_row, minlength=len(rows))])),
            "weight_dof": integers(dofs),
            "weight_coef": doubles(rows[of_row, dofs], (-1,)),
        }


def _slopes_of_tendons(model: mujoco.MjModel, tendons: Sequence[int]) -> Array:
    """How the length of each of ``tendons`` changes with each coordinate at qpos0 (nt, nv), by central differences.

    MuJoCo's own Jacobian has another layout in each of its versions.
    """
    slopes, data = np.zeros((len(tendons), model.nv)), mujoco.MjData(model)
    for dof in range(model.nv) if len(tendons) else ():
        for side in (-1.0, 1.0):
            data.qpos[:] = model.qpos0
            mujoco.mj_integratePos(model, data.qpos, np.eye(model.nv)[dof], side * _STEP)
            for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon):
                update(model, data)
            slopes[:, dof] += side * data.ten_length[list(tendons)] / (2.0 * _STEP)
    return slopes


def contact_factors(core: CoreArrays, factors: Array) -> Array:
    """How much softer each contact (nc,) is under ``factors`` (nweight,) on inverse weights."""
    changes = np.append(factors - 1.0, 0.0)  # the last: of what no mass changes
    softer: Array = 1.0 + (core.con_share * changes[core.con_weight.reshape(-1, 2)]).sum(axis=1)
    return softer


def line_factors(weights: Integers, factors: Array) -> Array:
    """The same of limits or lines, by their ``weights``: numbers, or -1."""
    softer: Array = np.append(factors, 1.0)[weights]
    return softer
