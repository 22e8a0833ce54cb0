"""The Jacobian of a step as a torch function, for derivatives that go forwards or many at a time.

Forward mode (``torch.func.jvp``, ``jacfwd``, dual numbers) multiplies it by tangents, and ``is_grads_batched`` by many
cotangents at once. It costs one pass of the core, whatever their number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from cmbrl.models.native_step.stepper import NO_SECOND, Stepper, plain
from cmbrl.models.native_step.transforms import apart, flat


class StepJacobian(torch.autograd.Function):
    """(q, v, u, theta) -> J (B, nq + nv, nq + nv + nu [+ np]) of (q', v') in (q, v, u [, theta]), in configurations.

    Raises UserError for its own derivative.
    """

    @staticmethod
    def forward(
        q: torch.Tensor, v: torch.Tensor, u: torch.Tensor, theta: torch.Tensor, stepper: Stepper, want_theta: bool
    ) -> torch.Tensor:
        """One pass of the core."""
        given = [plain(x) for x in (q, v, u, theta)]
        columns = np.arange(theta.shape[-1]) if want_theta else None
        out = stepper.forward(*given, jacobian=True, columns=columns)
        return torch.from_numpy(stepper.tangent.in_configurations(given[0], out["q_next"], out["jacobian"]))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        """Nothing: there is no second derivative."""

    @staticmethod
    def backward(ctx: Any, *_: torch.Tensor) -> Any:  # type: ignore[override]
        """Raises UserError."""
        raise NO_SECOND

    @staticmethod
    def jvp(ctx: Any, *_: torch.Tensor) -> Any:  # type: ignore[override]
        """Raises UserError."""
        raise NO_SECOND

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *given: Any) -> tuple[torch.Tensor, int]:
        """One batch of all rows."""
        *tensors, stepper, want_theta = given
        rows = flat(tensors, in_dims, info.batch_size)
        return apart(StepJacobian.apply(*rows, stepper, want_theta), info.batch_size), 0


def push_forward(
    stepper: Stepper, given: tuple[torch.Tensor, ...], tangents: tuple[torch.Tensor | None, ...]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Tangents (B, nq), (B, nv) of the next state from those of ``given`` (q, v, u, theta); None is zero."""
    q, v = given[:2]
    J = StepJacobian.apply(*given, stepper, tangents[3] is not None)
    places = np.cumsum([q.shape[1], v.shape[1], given[2].shape[1]]).tolist()
    moved = torch.zeros_like(J[:, :, 0])
    for part, tangent in zip(J.tensor_split(places, dim=2), tangents, strict=True):
        if tangent is not None:
            moved = moved + (part @ tangent if tangent.ndim == 1 else (part @ tangent[..., None])[..., 0])
    return moved[:, : q.shape[1]], moved[:, q.shape[1] :]


def pull_back(
    stepper: Stepper, given: tuple[torch.Tensor, ...], cotangents: tuple[torch.Tensor, torch.Tensor], want_theta: bool
) -> tuple[torch.Tensor | None, ...]:
    """Cotangents of ``given`` (q, v, u, theta), the last only if wanted, from those of the next state."""
    q, v, u, theta = given
    J = StepJacobian.apply(*given, stepper, want_theta)
    product = (torch.cat(cotangents, dim=1)[:, None] @ J)[:, 0]
    places = np.cumsum([q.shape[1], v.shape[1], u.shape[1]]).tolist()
    gq, gv, gu, gtheta = product.tensor_split(places, dim=1)
    if not want_theta:
        return gq, gv, gu, None
    return gq, gv, gu, gtheta.sum(0) if theta.ndim == 1 else gtheta
