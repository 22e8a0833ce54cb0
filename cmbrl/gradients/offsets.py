"""Cartesian noise at the contacting end of a chain, mapped to its joints by a damped pseudo-inverse."""

from __future__ import annotations

import numpy as np

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.records import WORLD, Array, JointKind


class ContactOffsets:
    """Random offsets (dq, dv) of the chains that are in contact (Bundled Contact Gradients, Aditya et al.).

    A chain ends at a link in contact; if the link touches in several places, the most loaded point is moved. The chain
    has the coordinates between the link and its base. A floating base belongs to its own chain only, so that one foot
    does not move the other. In a contact between two moving links, one moves relative to the other. The choice of the
    point and the exclusion of the base are ours; the paper says "final link".

    Args:
        model: whose contacts are moved.
        position, velocity: standard deviation of each Cartesian component [m, m/s].
        damping: lambda of J^T (J J^T + lambda I)^-1.
    """

    def __init__(self, model: ComplementarityModel, position: float, velocity: float, damping: float) -> None:
        self.model, self.deviations, self.damping = model, (position, velocity), damping
        core = model.scene.core
        pairs = list(zip(core.con_bodyA.tolist(), core.con_bodyB.tolist(), strict=True))
        self.groups = [np.flatnonzero([p == pair for p in pairs]) for pair in sorted(set(pairs))]
        self.chains = np.array([_chain(model.scene, pairs[group[0]]) for group in self.groups]).reshape(
            -1, model.scene.nv
        )

    def draw(
        self, q: Array, v: Array, load: Array, theta: Array | None, branches: int, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """(R, branches, nv) each, tangent at q (R, nq); ``load`` (R, nc) is positive for contacts that trigger."""
        rows = self.model.smooth_dynamics(q, v, theta)[
            "J"
        ]  # normal and tangents; the noise is isotropic, so that any frame will do
        dq, dv = (np.zeros((len(q), branches, v.shape[1])) for _ in range(2))
        for group, chain in zip(self.groups, self.chains, strict=True):
            touching = np.flatnonzero(load[:, group].max(axis=1) > 0)
            if not len(touching):
                continue
            contact = group[load[np.ix_(touching, group)].argmax(axis=1)]
            J = rows[touching, contact] * chain
            gram = J @ J.transpose(0, 2, 1) + self.damping * np.eye(J.shape[1])
            inverse = np.linalg.solve(gram, J)  # (r, D, nv): transposed pseudo-inverse
            for out, std in zip((dq, dv), self.deviations, strict=True):
                out[touching] += std * rng.normal(size=(len(touching), branches, J.shape[1])) @ inverse
        return dq, dv


def _chain(scene: Scene, pair: tuple[int, int]) -> Array:
    """1 for the coordinates (nv,) of the chain that ends at this pair of bodies, else 0."""
    core, mask = scene.core, np.zeros(scene.nv)
    alone = WORLD in pair
    for end in pair:
        body = end
        while body != WORLD:
            parent = int(core.body_parent[body])
            if parent != WORLD or (alone and body == end) or not _floats(scene, body):
                mask[_coordinates(scene, body)] = 1.0
            body = parent
    return mask


def _floats(scene: Scene, body: int) -> bool:
    """Whether a body without parent slides in every direction: a floating base, not the first link of an arm."""
    core = scene.core
    first = core.body_jadr[body]
    kinds = core.jnt_type[first : first + core.body_jnum[body]]
    return int((kinds == JointKind.SLIDE).sum()) == (2 if scene.planar else 3)


def _coordinates(scene: Scene, body: int) -> list[int]:
    joints = [joint for joint in scene.joints if joint.body == body]
    return [k for joint in joints for k in range(joint.vadr, joint.vadr + (3 if joint.kind == JointKind.BALL else 1))]
