"""How masses soften rows: MuJoCo's compliances grow with inverse weights, which masses and armatures determine.

MuJoCo takes the weights of qpos0: of a body w = tr(J M^-1 J^T) / 3 with the Jacobian J (3, nv) of its centre of mass,
of a joint the mean of its entries of the diagonal of M^-1, of a tendon J M^-1 J^T with the slope J (nv,) of its length.
With M = sum_k mu_k M_k in the scales mu of the masses and of the armatures,
-dw/dmu_k = tr(J M^-1 M_k M^-1 J^T) / 3 >= 0, and w is the sum of these. So

    w(mu) = w (1 + sum_k a_k (1/mu_k - 1)),  a_k = -(dw/dmu_k) / w,

has the right value and slope at mu = 1, is positive, and exact for free bodies and where all of them scale together:
motion then tells nothing about the unit of force, as in MuJoCo. Armatures A that the file does not have, with unit
matrices E_k, make of it

    w(mu, A) = w(mu) / (1 + w(mu) / w sum_k c_k A_k),  c_k = tr(J M^-1 E_k M^-1 J^T) / 3 w,

with the same properties, exact for a body on one joint. Centres of mass and shapes of inertias count as the file's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.core.core_arrays import CoreArrays
from cmbrl.scene.records import WORLD, Array, Tree

_NOTHING = 1e-15  # below it MuJoCo takes a weight for zero
_STEP = 1e-6  # [m, rad] of central differences
SOFTENED_LAWS = ("mujoco", "logistic")  #: whose compliance is a multiple of the inverse weight


def weight_arrays(
    model: mujoco.MjModel,
    tree: Tree,
    candidates: CandidateTable,
    limits: Mapping[str, Any],
    masses: Mapping[int, int],
    armatures: Mapping[int, int],
    contact_law: str,
    tendons: Sequence[int],
) -> dict[str, Any]:
    """The core's arrays: each inverse weight by the parameters that it depends on.

    ``masses``: body -> number; ``armatures``: degree of freedom -> number, also of those that are 0; ``limits``: the
    core's arrays of lines; ``tendons``: numbers in the file of those among the lines.
    """
    sides = model.geom_bodyid[candidates.geoms]
    weights = model.body_invweight0[sides, 0]
    total = weights.sum(axis=1, keepdims=True)
    touching = set(np.unique(sides).tolist()) if contact_law in SOFTENED_LAWS else set()
    shares = _Shares(model, tree, touching, masses, armatures, tendons)
    scales = [*masses.values(), *dict.fromkeys(armatures.values())]
    place = {number: k for k, number in enumerate(scales)}
    known = [{place[k]: x for k, x in row.items() if x > 0} for row in shares.rows]
    lines = np.full(model.nv + len(limits["tendon_ptr"]) - 1, -1)
    for dof, row in shares.of_dof.items():
        lines[dof] = row
    lines[model.nv : model.nv + len(tendons)] = shares.of_tendon
    of_body = np.full(model.nbody, -1)
    of_body[[*shares.of_body]] = [*shares.of_body.values()]
    return {
        "nmass": len(scales),
        "nweight": len(known),
        "mass_par": integers(scales),
        "weight_ptr": integers(np.cumsum([0, *map(len, known)])),
        "weight_mass": integers([k for row in known for k in row]),
        "weight_coef": doubles([x for row in known for x in row.values()], (-1,)),
        "con_weight": integers(of_body[sides]),
        "con_share": doubles(weights / np.where(total > 0, total, 1.0), (-1, 2)),
        "lim_weight": integers(lines[limits["lim_line"]]),
        "line_weight": integers(lines),
    }


class _Shares:
    """a_k and c_k by parameter: a row for each joint or tendon that may rub or end, and for some bodies of the file."""

    def __init__(
        self,
        model: mujoco.MjModel,
        tree: Tree,
        bodies: set[int],
        masses: Mapping[int, int],
        armatures: Mapping[int, int],
        tendons: Sequence[int],
    ) -> None:
        self.rows: list[dict[int, float]] = []
        self.of_dof: dict[int, int] = {}
        self.of_body: dict[int, int] = {}
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        jacobians = _Jacobians(model, data)
        pulls = [_Weight() for _ in tendons]  # a tendon may tie several trees
        slopes = _slopes_of_tendons(model, tendons)
        welded: dict[int, list[int]] = {}
        for body, frame in enumerate(tree.frames):
            welded.setdefault(frame.body, []).append(body)
        for members in _trees(tree):
            dofs = np.array([d for k in members for joint in tree.bodies[k].joints for d in joint.dofs])
            roots = {k: jacobians.root(welded[k], dofs) for k in members}
            armature = model.dof_armature[dofs]
            inverse = np.linalg.pinv(sum(root.T @ root for root in roots.values()) + np.diag(armature), hermitian=True)
            parts = {masses[k]: root for k, root in roots.items() if k in masses}
            for number in dict.fromkeys(armatures[d] for d in dofs if d in armatures):
                those = np.array([armatures.get(d) == number for d in dofs])
                parts[number] = np.diag(np.sqrt(armature if armature[those].any() else np.ones(len(dofs))))[those]
            for pull, slope in zip(pulls, slopes, strict=True):
                pull.add(slope[None, dofs], inverse, parts)
            for k in members:
                for joint in tree.bodies[k].joints:
                    if model.jnt_type[joint.source] != mujoco.mjtJoint.mjJNT_FREE:
                        self.of_dof.update(dict.fromkeys(joint.dofs, len(self.rows)))
                        self.rows.append(
                            _Weight().add(np.eye(len(dofs))[np.isin(dofs, joint.dofs)], inverse, parts).shares
                        )
                for body in bodies.intersection(welded[k]):
                    self.of_body[body] = len(self.rows)
                    self.rows.append(_Weight().add(jacobians.of(body, dofs)[:3], inverse, parts).shares)
        self.of_tendon = [len(self.rows) + k for k in range(len(pulls))]
        self.rows += [pull.shares for pull in pulls]


@dataclass
class _Weight:
    """A weight tr(J M^-1 J^T), and its part by parameter, summed over trees."""

    total: float = 0.0
    parts: dict[int, float] = field(default_factory=dict)

    def add(self, J: Array, inverse: Array, parts: Mapping[int, Array]) -> _Weight:
        """With ``J`` (m, n) of one tree, whose M has the ``inverse`` (n, n) and ``parts`` R (r, n), each R^T R."""
        moved = J @ inverse
        self.total += float(np.sum(moved * J))
        for k, part in parts.items():
            self.parts[k] = self.parts.get(k, 0.0) + float(np.sum((moved @ part.T) ** 2))
        return self

    @property
    def shares(self) -> dict[int, float]:
        """a_k or c_k by parameter; none of a weight that counts as zero."""
        return {} if self.total < _NOTHING else {k: part / self.total for k, part in self.parts.items()}


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


class _Jacobians:
    """Jacobians (6, n) of the centres of mass of a file's bodies at qpos0, for some dofs."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data = model, data
        self._buffer = np.zeros((6, model.nv))

    def of(self, body: int, dofs: Array) -> Array:
        mujoco.mj_jacBodyCom(self.model, self.data, self._buffer[:3], self._buffer[3:], body)
        return self._buffer[:, dofs]

    def root(self, bodies: Sequence[int], dofs: Array) -> Array:
        """R (m, n), of which R^T R is what ``bodies`` add to the mass matrix."""
        rows = []
        for body in bodies:
            J = self.of(body, dofs)
            axes = self.data.ximat[body].reshape(3, 3)
            rows.append(np.sqrt(self.model.body_mass[body]) * J[:3])
            rows.append(np.sqrt(self.model.body_inertia[body])[:, None] * (axes.T @ J[3:]))
        return np.concatenate(rows)


def _trees(tree: Tree) -> Iterator[list[int]]:
    """Moving bodies by the root that carries them."""
    root = list(range(len(tree.bodies)))
    members: dict[int, list[int]] = {}
    for k, body in enumerate(tree.bodies):
        if body.parent != WORLD:
            root[k] = root[body.parent]
        members.setdefault(root[k], []).append(k)
    yield from members.values()


def factors(core: CoreArrays, theta: Array) -> Array:
    """What inertia at ``theta`` makes of each inverse weight (nweight,) (in the core: load_weights)."""
    nominal, value = core.par_nominal[core.mass_par], theta[core.mass_par]
    scales = nominal > 0.0
    lighter = np.where(scales, nominal / np.where(scales, value, 1.0) - 1.0, value)
    change, of_scales = core.weight_coef * lighter[core.weight_mass], scales[core.weight_mass]
    rows = np.repeat(np.arange(core.nweight), np.diff(core.weight_ptr))
    found, added = (np.bincount(rows[of], change[of], core.nweight) for of in (of_scales, ~of_scales))
    return (1.0 + found) / (1.0 + (1.0 + found) * added)


def soften(core: CoreArrays, theta: Array, P: Array) -> None:
    """Scales the softness of contacts in the physical vector P by inertia at ``theta``."""
    changes = np.append(factors(core, theta) - 1.0, 0.0)  # the last: of what no mass changes
    of_contacts = 1.0 + (core.con_share * changes[core.con_weight.reshape(-1, 2)]).sum(axis=1)
    P[core.layout.contacts(np.arange(core.ncontact), "rscale")] *= of_contacts
