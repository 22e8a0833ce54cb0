"""Configurations as torch tensors: where the quaternions sit, and the step along the manifold.

`Scene.difference` and `Scene.integrate` do this for numpy arrays; a model that is to be differentiated through a
rollout, or loaded without its scene, needs the same map in torch.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from cmbrl.scene import Scene

BALL = 2  # joint type of scene.core.jnt_type; 0 slide, 1 hinge


@dataclass(frozen=True)
class Layout:
    """Sizes of a state, and the addresses of its scalar (slide, hinge) and quaternion (ball) coordinates."""

    nq: int
    nv: int
    nu: int
    scalar_q: tuple[int, ...]  # addresses in q of slides and hinges, and of the same joints in v
    scalar_v: tuple[int, ...]
    hinges_q: tuple[int, ...]  # those of scalar_q that are angles
    ball_q: tuple[int, ...]  # first address in q of each quaternion (wxyz), and in v of its angular velocity
    ball_v: tuple[int, ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Layout:
        kinds, q_address, v_address = (
            x.tolist() for x in (scene.core.jnt_type, scene.core.jnt_qadr, scene.core.jnt_vadr)
        )
        joints = list(zip(kinds, q_address, v_address, strict=True))
        return cls(
            nq=scene.nq,
            nv=scene.nv,
            nu=scene.nu,
            scalar_q=tuple(a for kind, a, _ in joints if kind != BALL),
            scalar_v=tuple(a for kind, _, a in joints if kind != BALL),
            hinges_q=tuple(a for kind, a, _ in joints if kind == 1),
            ball_q=tuple(a for kind, a, _ in joints if kind == BALL),
            ball_v=tuple(a for kind, _, a in joints if kind == BALL),
        )

    @property
    def slides_v(self) -> tuple[int, ...]:
        """Addresses in v of the velocities in m/s; all others are in rad/s."""
        pairs = zip(self.scalar_q, self.scalar_v, strict=True)
        return tuple(velocity for position, velocity in pairs if position not in self.hinges_q)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Layout:
        lists_as_tuples: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return cls(**lists_as_tuples)

    def integrate(self, q: Tensor, dq: Tensor) -> Tensor:
        """q (+) dq, (B, nq) from (B, nq) and a tangent vector (B, nv): rotations turn in the body frame.

        Same map as `Scene.integrate`, differentiable.
        """
        if not self.ball_q:
            return q + dq
        parts = torch.empty_like(q)
        parts[..., self.scalar_q] = q[..., self.scalar_q] + dq[..., self.scalar_v]
        for a, b in zip(self.ball_q, self.ball_v, strict=True):
            parts[..., a : a + 4] = turn(q[..., a : a + 4], dq[..., b : b + 3])
        return parts

    def difference(self, q_from: Tensor, q_to: Tensor) -> Tensor:
        """The tangent vector (B, nv) with q_from (+) it = q_to (B, nq): same map as `Scene.difference`."""
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
    bv = rotation / 2 * torch.sinc(half / torch.pi)  # torch.sinc(x) is sin(pi x) / (pi x): smooth at no rotation
    aw, av = quaternion[..., :1], quaternion[..., 1:]
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    vector = aw * bv + bw * av + torch.linalg.cross(av, bv)
    product = torch.cat([w, vector], dim=-1)
    return product / torch.linalg.vector_norm(product, dim=-1, keepdim=True)


def rotation_between(start: Tensor, end: Tensor) -> Tensor:
    """The rotation vector (..., 3) [rad], at most pi long, in the frame of ``start`` that turns it into ``end``."""
    aw, av, bw, bv = start[..., :1], start[..., 1:], end[..., :1], end[..., 1:]
    w = aw * bw + (av * bv).sum(-1, keepdim=True)
    vector = aw * bv - bw * av - torch.linalg.cross(av, bv)
    sign = torch.where(w < 0, -1.0, 1.0)  # q and -q are the same rotation: take the shorter way
    sine = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, sign * w)
    return torch.where(sine > 0, sign * angle / sine.clamp(min=1e-300), 2 * sign) * vector


def rotation_matrix(quaternion: Tensor) -> Tensor:
    """The nine entries (..., 9) of the rotation matrix of a unit quaternion wxyz (..., 4); the same for q and -q."""
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

    They are the slides of a body without parent that come before any rotation: the translation of a free joint, the
    root slides of a planar robot. Neither the mass matrix nor the smooth forces (springs aside) depend on them.
    """
    core = scene.core
    found = []
    for body, parent in enumerate(core.body_parent.tolist()):
        if parent >= 0:
            continue
        first = int(core.body_jadr[body])
        for joint in range(first, first + int(core.body_jnum[body])):
            if core.jnt_type[joint] != 0:
                break
            found.append((joint, int(core.jnt_qadr[joint]), int(core.jnt_vadr[joint])))
    return found


def invariant_translations(scene: Scene) -> list[int]:
    """Addresses in q along which the dynamics are the same everywhere: x of a robot on an infinite floor.

    A free translation that no contact gap, joint limit, spring or servo depends on. Gaps are compared at shifted
    random configurations, so obstacles and inclined planes count.
    """
    core = scene.core
    rng = np.random.default_rng(0)
    q = scene.integrate(np.repeat(scene.q0[None], 8, axis=0), rng.uniform(-0.5, 0.5, (8, scene.nv)))
    gaps = scene.gaps(q)
    # the physical vector: bodies (4 or 10 numbers), dofs (5), contacts (9), planes (1), actuators (5), gravity
    first_dof = int(core.nbody) * (4 if scene.planar else 10)
    first_actuator = first_dof + 5 * scene.nv + 9 * int(core.ncontact) + int(core.nplane)
    found = []
    for _, q_address, v_address in free_translations(scene):
        shifted = q.copy()
        shifted[:, q_address] += 0.37
        limited = v_address in core.lim_dof.tolist()
        sprung = core.P[first_dof + 5 * v_address + 2] != 0
        servo = any(
            core.P[first_actuator + 5 * k + 3] != 0 for k, dof in enumerate(core.act_dof.tolist()) if dof == v_address
        )
        if not (limited or sprung or servo) and np.allclose(scene.gaps(shifted), gaps, rtol=0, atol=1e-9):
            found.append(q_address)
    return found
