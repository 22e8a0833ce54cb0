"""A native step under ``torch.func`` and dual numbers, of which torch asks for functions of another form.

torch's eager functions are faster, since these bind their arguments anew in every call; a step takes them only where a
transform is active.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch.autograd import forward_ad

from cmbrl.models.native_step.stepper import NO_SECOND, Stepper, step_backward, step_forward

_transformed: Callable[[], bool] = getattr(torch._C, "_are_functorch_transforms_active", lambda: False)


def transforms() -> bool:
    """Whether torch.func transforms what is called now."""
    return _transformed()


def dual(*given: torch.Tensor) -> bool:
    """Whether one of ``given`` carries a tangent; only a level of dual numbers lets them."""
    if getattr(forward_ad, "_current_level", 0) < 0:
        return False
    return any(forward_ad.unpack_dual(x).tangent is not None for x in given)


class Report:
    """What the core returned. torch hands on an object as it is, and copies a dict."""

    def __init__(self) -> None:
        self.results: dict[str, Any] = {}


class TransformedStep(torch.autograd.Function):
    """(q, v, u, theta) -> (q_next, v_next), as :class:`cmbrl.models.native_step.autograd.NativeStep`."""

    @staticmethod
    def forward(  # type: ignore[override]
        q: torch.Tensor,
        v: torch.Tensor,
        u: torch.Tensor,
        theta: torch.Tensor,
        stepper: Stepper,
        report: Report,
        impulse: bool,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Runs the native step with a tape; its other results go into ``report``."""
        return step_forward(q, v, u, theta, stepper, report.results, impulse, record=True)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        """Keeps what the backward pass needs."""
        *given, ctx.stepper, report, _ = inputs
        ctx.tape = report.results["tape"]
        ctx.save_for_backward(*given, output[0])
        ctx.save_for_forward(*given)

    @staticmethod
    def backward(ctx: Any, gq_next: torch.Tensor, gv_next: torch.Tensor) -> Any:  # type: ignore[override]
        """Vector-Jacobian product from the tape."""
        q, v, u, theta, q_next = ctx.saved_tensors
        given = q, v, u, theta, gq_next, gv_next, q_next
        return *TransformedGradient.apply(*given, ctx.stepper, ctx.tape, ctx.needs_input_grad[3]), None, None, None

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> tuple[torch.Tensor, torch.Tensor]:
        """Jacobian times tangents of q, v, u and theta."""
        from cmbrl.models.native_step.jacobian import push_forward  # which stands above

        return push_forward(ctx.stepper, ctx.saved_tensors, tangents[:4])

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[int | None, ...], *given: Any
    ) -> tuple[tuple[torch.Tensor, torch.Tensor], tuple[int, int]]:
        """One batch of all rows."""
        *tensors, stepper, report, impulse = given
        rows = flat(tensors, in_dims, info.batch_size)
        q_next, v_next = TransformedStep.apply(*rows, stepper, report, impulse)
        return (apart(q_next, info.batch_size), apart(v_next, info.batch_size)), (0, 0)


class TransformedGradient(torch.autograd.Function):
    """The backward pass of :class:`TransformedStep`; raises UserError for a second derivative."""

    @staticmethod
    def forward(*given: Any) -> Any:
        """Cotangents of q, v, u and, if wanted, theta."""
        return step_backward(*given)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        """Nothing: there is no second derivative."""

    @staticmethod
    def backward(ctx: Any, *_: torch.Tensor) -> Any:
        """Raises UserError."""
        raise NO_SECOND

    @staticmethod
    def jvp(ctx: Any, *_: torch.Tensor) -> Any:
        """Raises UserError."""
        raise NO_SECOND

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *given: Any) -> tuple[Any, Any]:
        """Many states with a cotangent each are one batch; many cotangents of the same states one pass each."""
        *tensors, stepper, tape, want_theta = given
        size = info.batch_size
        found: list[Any]
        if all(dim is None for dim in in_dims[:4]):
            passes = [
                TransformedGradient.apply(*_chosen(tensors, in_dims, k), stepper, tape, want_theta) for k in range(size)
            ]
            found = [torch.stack(column) if column[0] is not None else None for column in zip(*passes, strict=True)]
        else:
            rows = flat(tensors, in_dims, size)
            found = [
                None if x is None else apart(x, size)
                for x in TransformedGradient.apply(*rows, stepper, tape, want_theta)
            ]
            if want_theta and tensors[3].ndim - (in_dims[3] is not None) == 1:  # one theta for the rows of a batch
                found[3] = found[3].sum(1)
        return tuple(found), tuple(None if x is None else 0 for x in found)


def _chosen(tensors: list[torch.Tensor], dims: tuple[int | None, ...], k: int) -> list[torch.Tensor]:
    return [x if dim is None else x.select(dim, k) for x, dim in zip(tensors, dims, strict=False)]


def flat(tensors: list[torch.Tensor], dims: tuple[int | None, ...], size: int) -> list[torch.Tensor]:
    """Of ``size`` batches (B, ...) each, one batch (size * B, ...); theta (np,) is that of every row."""
    stacked = [
        x.expand(size, *x.shape) if dim is None else x.movedim(dim, 0) for x, dim in zip(tensors, dims, strict=False)
    ]
    rows = stacked[0].shape[1]
    stacked = [x if x.ndim == 3 else x[:, None].expand(size, rows, x.shape[-1]) for x in stacked]
    return [x.reshape(size * rows, x.shape[-1]) for x in stacked]


def apart(x: torch.Tensor, size: int) -> torch.Tensor:
    return x.reshape(size, -1, *x.shape[1:])


def transformed_step(
    given: tuple[torch.Tensor, ...], stepper: Stepper, impulse: bool
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """q_next, v_next and what else the core returned, of all rows of a vmap together."""
    report = Report()
    q_next, v_next = TransformedStep.apply(*given, stepper, report, impulse)
    return q_next, v_next, report.results
