"""Configurations as torch tensors: the kinds of coordinates, and steps along the manifold.

`Scene.difference` and `Scene.integrate` do the same for numpy arrays. Models that are differentiated through a rollout,
or loaded without their scene, need it in torch.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.scene.kinematics import lines_by_dof
from cmbrl.scene.records import JointKind, TieKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene
    from cmbrl.scene.core.core_arrays import CoreArrays


@dataclass(frozen=True)
class Coordinates:
    """Sizes of a state, and addresses of its scalar (slide, hinge) and quaternion (ball) coordinates."""

    nq: int
    nv: int
    nu: int
    scalar_q: tuple[int, ...]  # addresses of slides and hinges in q, and of the same joints in v
    scalar_v: tuple[int, ...]
    hinges_q: tuple[int, ...]  # the angles among scalar_q
    ball_q: tuple[int, ...]  # first address of each quaternion (wxyz) in q, and of its angular velocity in v
    ball_v: tuple[int, ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Coordinates:
        """The coordinates of a scene."""
        kinds, q_address, v_address = (
            x.tolist() for x in (scene.core.jnt_type, scene.core.jnt_qadr, scene.core.jnt_vadr)
        )
        joints = list(zip(kinds, q_address, v_address, strict=True))
        return cls(
            nq=scene.nq,
            nv=scene.nv,
            nu=scene.nu,
            scalar_q=tuple(a for kind, a, _ in joints if kind != JointKind.BALL),
            scalar_v=tuple(a for kind, _, a in joints if kind != JointKind.BALL),
            hinges_q=tuple(a for kind, a, _ in joints if kind == JointKind.HINGE),
            ball_q=tuple(a for kind, a, _ in joints if kind == JointKind.BALL),
            ball_v=tuple(a for kind, _, a in joints if kind == JointKind.BALL),
        )

    @property
    def slides_v(self) -> tuple[int, ...]:
        """Addresses of the velocities in m/s; all others are in rad/s."""
        pairs = zip(self.scalar_q, self.scalar_v, strict=True)
        return tuple(velocity for position, velocity in pairs if position not in self.hinges_q)

    def to_dict(self) -> dict[str, Any]:
        """JSON types; the inverse is ``from_dict``."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Coordinates:
        """Inverse of ``to_dict``; raises TypeError or ValueError for what is no such description."""
        lists_as_tuples: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        found = cls(**lists_as_tuples)
        in_q = [*found.scalar_q, *(a + k for a in found.ball_q for k in range(4))]
        in_v = [*found.scalar_v, *(a + k for a in found.ball_v for k in range(3))]
        whole = sorted(in_q) == list(range(len(in_q))) and sorted(in_v) == list(range(len(in_v)))
        if not whole or (len(in_q), len(in_v)) != (found.nq, found.nv) or not set(found.hinges_q) <= set(in_q):
            raise ValueError("its coordinates do not fill q and v")
        return found

    def integrate(self, q: Tensor, dq: Tensor) -> Tensor:
        """q (+) dq (B, nq) from q (B, nq) and tangent vectors dq (B, nv), rotations in the body frame.

        The same map as `Scene.integrate`, differentiable.
        """
        if not self.ball_q:
            return q + dq
        parts = torch.empty_like(q)
        parts[..., self.scalar_q] = q[..., self.scalar_q] + dq[..., self.scalar_v]
        for a, b in zip(self.ball_q, self.ball_v, strict=True):
            parts[..., a : a + 4] = turn(q[..., a : a + 4], dq[..., b : b + 3])
        return parts

    def difference(self, q_from: Tensor, q_to: Tensor) -> Tensor:
        """Tangent vectors (B, nv) from q_from to q_to (B, nq): the same map as `Scene.difference`."""
        if not self.ball_q:
            return q_to - q_from
        change = q_from.new_empty(*q_from.shape[:-1], self.nv)
        change[..., self.scalar_v] = q_to[..., self.scalar_q] - q_from[..., self.scalar_q]
        for a, b in zip(self.ball_q, self.ball_v, strict=True):
            change[..., b : b + 3] = rotation_between(q_from[..., a : a + 4], q_to[..., a : a + 4])
        return change


def turn(quaternion: Tensor, rotation: Tensor) -> Tensor:
    """quaternion * exp(rotation / 2), wxyz, normalised: (..., 4) from (..., 4) and a rotation vector (..., 3) [rad]."""
    half = torch.linalg.vector_norm(rotation, dim=-1, keepdim=True) / 2
    bw = torch.cos(half)
    bv = rotation / 2 * torch.sinc(half / torch.pi)  # torch.sinc(x) is sin(pi x) / (pi x): smooth at zero
    aw, av = quaternion[..., :1], quaternion[..., 1:]
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    vector = aw * bv + bw * av + torch.linalg.cross(av, bv)
    product = torch.cat([w, vector], dim=-1)
    return product / torch.linalg.vector_norm(product, dim=-1, keepdim=True)


def rotation_between(start: Tensor, end: Tensor) -> Tensor:
    """The rotation vector (..., 3) [rad], |r| <= pi, in the frame of ``start``, that turns ``start`` into ``end``."""
    aw, av, bw, bv = start[..., :1], start[..., 1:], end[..., :1], end[..., 1:]
    w = aw * bw + (av * bv).sum(-1, keepdim=True)
    vector = aw * bv - bw * av - torch.linalg.cross(av, bv)
    sign = torch.where(w < 0, -1.0, 1.0)  # q and -q are the same rotation; take the shorter
    sine = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, sign * w)
    return torch.where(sine > 0, sign * angle / sine.clamp(min=1e-300), 2 * sign) * vector


def rotation_matrix(quaternion: Tensor) -> Tensor:
    """Entries (..., 9) of the rotation matrix of unit quaternions wxyz (..., 4); the same for q and -q."""
    w, x, y, z = quaternion.unbind(-1)
    return torch.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        dim=-1,
    )


def free_translations(scene: Scene) -> list[tuple[int, int, int]]:
    """(joint, address in q, address in v) of the slides that move a whole tree along a fixed direction of the world.

    These are the slides of a root body before any rotation: the translation of a free joint, or the root slides of a
    planar robot. Neither the mass matrix nor the smooth forces (springs aside) depend on them.
    """
    core = scene.core
    found = []
    for body, parent in enumerate(core.body_parent.tolist()):
        if parent >= 0:
            continue
        first = int(core.body_jadr[body])
        for joint in range(first, first + int(core.body_jnum[body])):
            if core.jnt_type[joint] != JointKind.SLIDE:
                break
            found.append((joint, int(core.jnt_qadr[joint]), int(core.jnt_vadr[joint])))
    return found


def _tied(core: CoreArrays, body: int, lines: set[int]) -> bool:
    """Whether an equality constraint ties one of ``lines``, or ``body`` or what it carries to anything else."""
    carried = {body}
    for child, parent in enumerate(core.body_parent):
        if parent in carried:
            carried.add(child)
    for kind, *ends in zip(core.tie_type, core.tie_A, core.tie_B, strict=True):
        if kind == TieKind.POLYNOMIAL:
            if not lines.isdisjoint(ends):
                return True
        elif (ends[0] in carried) != (ends[1] in carried):
            return True
    return False


def invariant_translations(scene: Scene) -> list[int]:
    """Addresses in q along which the dynamics do not change, such as x of a robot on an infinite floor.

    They are free translations that no contact gap, joint limit, spring or servo depends on. Gaps are compared at
    shifted random configurations, so obstacles and inclined planes count.
    """
    core, layout, lines = scene.core, scene.layout, lines_by_dof(scene.core)
    rng = np.random.default_rng(0)
    q = scene.integrate(np.repeat(scene.q0[None], 8, axis=0), rng.uniform(-0.5, 0.5, (8, scene.nv)))
    gaps = scene.gaps(q)
    found = []
    for joint, q_address, v_address in free_translations(scene):
        shifted = q.copy()
        shifted[:, q_address] += 0.37
        pulls = set(np.flatnonzero(lines[:, v_address]).tolist())  # lines that it is part of
        limited = not pulls.isdisjoint(core.lim_line.tolist())
        sprung = any(core.P[layout.dof(line, "stiffness")] != 0 for line in pulls)
        servo = any(core.P[layout.actuator(k, "bias1")] != 0 for k, line in enumerate(core.act_line) if line in pulls)
        tied = _tied(core, int(core.jnt_body[joint]), pulls)
        if not (limited or sprung or servo or tied) and np.allclose(scene.gaps(shifted), gaps, rtol=0, atol=1e-9):
            found.append(q_address)
    return found
