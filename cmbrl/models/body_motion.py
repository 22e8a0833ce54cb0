"""Where bodies and sites are and how they move at a state, differentiable: for observations, rewards, terminations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError, did_you_mean
from cmbrl.models.native_step.stepper import TangentMap
from cmbrl.models.native_step.transforms import apart, dual, flat, transforms
from cmbrl.native import Core
from cmbrl.scene import Scene

_NO_SECOND = UserError("body motions have first derivatives only: leave out create_graph=True")


@dataclass(frozen=True)
class BodyMotion:
    """Motion of nb bodies in B states, in world axes.

    position (B, nb, 3) [m] and linear (B, nb, 3) [m/s] of each body's origin, rotation (B, nb, 3, 3), angular
    (B, nb, 3) [rad/s].
    """

    position: Tensor
    rotation: Tensor
    linear: Tensor
    angular: Tensor


class BodyMotions:
    """The motion of some bodies of a scene as a function of its state.

    Args:
        scene: the scene; spatial, so read with ``reduce=False`` if it is planar.
        bodies: their names, in the order wanted. A body without joints moves with the one that it is fixed to, and so
            does a site of the file, such as a tool's tip.
        threads: native threads.

    Raises UserError for an unknown body, one that does not move, and for a planar scene.
    """

    def __init__(self, scene: Scene, bodies: Sequence[str], threads: int = 1) -> None:
        if scene.planar:
            raise UserError(f"{scene.name}: body motions need spatial algebra: read the scene with reduce=False")
        if unknown := [name for name in bodies if name not in scene.places]:
            told = did_you_mean(unknown[0], scene.places)
            raise UserError(f"{scene.name} has no body or site {unknown[0]!r} that moves: {told}")
        self.names, self.threads = tuple(bodies), threads
        self._scene = scene
        self._core, self._tangent = Core(scene.core.to_native()), TangentMap(scene)
        places = [scene.places[name] for name in bodies]
        self._chosen = np.array([place.body for place in places], dtype=np.int64)
        self._offset = torch.tensor(np.array([place.pos for place in places]).reshape(-1, 3))
        self._turn = torch.tensor(np.array([place.rot for place in places]).reshape(-1, 3, 3))
        self._carried = bool((self._offset != 0).any() or (self._turn != torch.eye(3)).any())

    def __call__(self, q: Tensor, v: Tensor) -> BodyMotion:
        """The motion at q (B, nq), v (B, nv), float64; NaN in a row that is not finite."""
        followed = torch.is_grad_enabled() or transforms() or dual(q, v)
        x = _Motion.apply(q, v, self).unflatten(1, (-1, 18)) if followed else self.forward(q, v)
        position, rotation, linear, angular = x[..., :3], x[..., 3:12].unflatten(-1, (3, 3)), x[..., 12:15], x[..., 15:]
        if self._carried:
            arm = (rotation @ self._offset[..., None])[..., 0]
            position, rotation = position + arm, rotation @ self._turn
            linear = linear + torch.linalg.cross(angular, arm)
        return BodyMotion(position, rotation, linear, angular)

    def __reduce__(self) -> tuple[Any, ...]:
        return BodyMotions, (self._scene, self.names, self.threads)

    def forward(self, q: Tensor, v: Tensor) -> Tensor:
        """(B, nb, 18): position, rotation by rows, linear and angular velocity; without a derivative."""
        return torch.from_numpy(self._core.bodies(_array(q), _array(v), self._chosen, self.threads))

    def backward(self, q: Tensor, v: Tensor, cotangent: Tensor) -> tuple[Tensor, Tensor]:
        """Cotangents of q (B, nq) and v (B, nv) from those (B, nb, 18) of the motion."""
        at = _array(q)
        gq, gv = self._core.bodies_backward(at, _array(v), self._chosen, _array(cotangent), self.threads)
        return torch.from_numpy(self._tangent.to_configuration(at, gq)), torch.from_numpy(gv)


class _Motion(torch.autograd.Function):
    """The motion (B, nb * 18), under torch.func as well; its derivative goes backwards only."""

    @staticmethod
    def forward(q: Tensor, v: Tensor, bodies: BodyMotions) -> Tensor:
        """The motion."""
        return bodies.forward(q, v).flatten(1)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        """Remembers the state."""
        ctx.bodies = inputs[2]
        ctx.save_for_backward(*inputs[:2])

    @staticmethod
    def backward(ctx: Any, g: Tensor) -> Any:  # type: ignore[override]
        """Product with the derivative of the motion."""
        return *_Gradient.apply(*ctx.saved_tensors, g, ctx.bodies), None

    @staticmethod
    def jvp(ctx: Any, *_: Tensor) -> Any:  # type: ignore[override]
        """Raises UserError."""
        raise UserError("derivatives of body motions go backwards only: use jacrev, vjp or grad")

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *given: Any) -> tuple[Tensor, int]:
        """One batch of all rows."""
        rows = flat(list(given[:2]), in_dims, info.batch_size)
        return apart(_Motion.apply(*rows, given[2]), info.batch_size), 0


class _Gradient(torch.autograd.Function):
    """Cotangents of q and v; raises UserError for a second derivative."""

    @staticmethod
    def forward(q: Tensor, v: Tensor, g: Tensor, bodies: BodyMotions) -> tuple[Tensor, Tensor]:
        """Those of the motion's cotangent g (B, nb * 18)."""
        return bodies.backward(q, v, g.unflatten(1, (-1, 18)))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        """Nothing: there is no second derivative."""

    @staticmethod
    def backward(ctx: Any, *_: Tensor) -> Any:  # type: ignore[override]
        """Raises UserError."""
        raise _NO_SECOND

    @staticmethod
    def jvp(ctx: Any, *_: Tensor) -> Any:  # type: ignore[override]
        """Raises UserError."""
        raise _NO_SECOND

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *given: Any) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
        """One batch of all rows."""
        gq, gv = _Gradient.apply(*flat(list(given[:3]), in_dims, info.batch_size), given[3])
        return (apart(gq, info.batch_size), apart(gv, info.batch_size)), (0, 0)


def _array(x: Tensor) -> np.ndarray:
    return np.ascontiguousarray(x.detach().numpy())
