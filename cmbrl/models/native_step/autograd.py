"""The native step as a torch function, and what it takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from cmbrl.errors import UserError
from cmbrl.models.native_step.jacobian import pull_back
from cmbrl.models.native_step.stepper import NO_SECOND, Stepper, plain, step_backward, step_forward
from cmbrl.models.native_step.transforms import dual, transformed_step, transforms
from cmbrl.scene import Scene

#: whether a tensor stands for many, as of ``is_grads_batched``
_many: Callable[[torch.Tensor], bool] = getattr(torch._C._functorch, "is_legacy_batchedtensor", lambda _: False)


def check_tensors(scene: Scene, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor, theta: torch.Tensor | None) -> None:
    """Raises UserError unless q, v, u (B, ...) and theta (np,) or (B, np), if given, are what a step takes."""
    widths = scene.nq, scene.nv, scene.inputs
    rows = [_rows(x, name, width) for x, name, width in zip((q, v, u), "qvu", widths, strict=True)]
    if not rows[0] == rows[1] == rows[2]:
        raise UserError(f"q, v, u have {rows[0]}, {rows[1]}, {rows[2]} rows; give the same number of rows")
    count = len(scene.parameters)
    if theta is not None and _dense(theta, "theta") not in ((count,), (rows[0], count)):
        raise UserError(f"theta has shape {tuple(theta.shape)}; give ({count},) or (batch, {count})")


def _rows(x: torch.Tensor, name: str, width: int) -> int:
    """The number of rows of x (B, width); raises UserError for another type or shape."""
    shape = _dense(x, name)
    if len(shape) != 2 or shape[1] != width:
        raise UserError(f"{name} has shape {tuple(shape)}; give float64 of shape (batch, {width})")
    return shape[0]


def _dense(x: torch.Tensor, name: str) -> torch.Size:
    """The shape of x; raises UserError unless it is a dense float64 tensor on the CPU."""
    if not isinstance(x, torch.Tensor):
        raise UserError(f"{name} is a {type(x).__name__}; give a float64 tensor")
    if x.dtype != torch.float64 or x.layout != torch.strided or not x.is_cpu:
        raise UserError(f"{name} is {x.dtype}, {x.layout} on {x.device}; give dense float64 on the CPU")
    return x.shape


def differentiable_step(
    stepper: Stepper, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor, theta: torch.Tensor, impulse: bool
) -> tuple[torch.Tensor, torch.Tensor, dict[str, np.ndarray]]:
    """q_next, v_next and what else the core returned; without torch's machinery where no gradient is asked for."""
    if torch.compiler.is_compiling():
        raise UserError("torch.compile cannot look into a contact step: call it through torch.compiler.disable")
    given = q, v, u, theta
    if transforms() or dual(*given):
        return transformed_step(given, stepper, impulse)
    if torch.is_grad_enabled() and any(x.requires_grad for x in given):
        report: dict[str, np.ndarray] = {}
        q_next, v_next = NativeStep.apply(*given, stepper, report, impulse)
        return q_next, v_next, report
    out = stepper.forward(*map(plain, given), impulse=impulse)
    return torch.from_numpy(out["q_next"]), torch.from_numpy(out["v_next"]), out


class NativeStep(torch.autograd.Function):
    """(q, v, u, theta) -> (q_next, v_next) of a :class:`Stepper`."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        q: torch.Tensor,
        v: torch.Tensor,
        u: torch.Tensor,
        theta: torch.Tensor,
        stepper: Stepper,
        report: dict[str, np.ndarray],
        impulse: bool,
    ) -> Any:
        """Runs the native step, with a tape if a gradient is needed; its other results go into ``report``."""
        record = any(ctx.needs_input_grad[:4])
        q_next, v_next = step_forward(q, v, u, theta, stepper, report, impulse, record)
        if record:
            ctx.stepper, ctx.tape = stepper, report["tape"]
            end = () if stepper.tangent.trivial else (q_next,)
            ctx.save_for_backward(q, v, u, theta, *end)  # torch notices if one of them is changed in place
        return q_next, v_next

    @staticmethod
    def backward(ctx: Any, gq_next: torch.Tensor, gv_next: torch.Tensor) -> Any:  # type: ignore[override]
        """Vector-Jacobian product from the tape."""
        q, v, u, theta, *end = ctx.saved_tensors
        if _many(gq_next) or _many(gv_next):
            found = pull_back(ctx.stepper, (q, v, u, theta), (gq_next, gv_next), ctx.needs_input_grad[3])
            return *found, None, None, None
        q_next = end[0].detach() if end else None
        # Gradients are on here under create_graph only. Otherwise a second function would add a tenth for nothing.
        product = _Gradient.apply if torch.is_grad_enabled() else step_backward
        gradients = product(q, v, u, theta, gq_next, gv_next, q_next, ctx.stepper, ctx.tape, ctx.needs_input_grad[3])
        return *gradients, None, None, None


class _Gradient(torch.autograd.Function):
    """The backward pass of :class:`NativeStep` as a function of its own, so that a second derivative is refused.

    Under ``create_graph=True`` the gradient of a step stands in a graph. What goes through it again would be lost
    without a word if the gradient were a constant there.
    """

    @staticmethod
    def forward(ctx: Any, *given: Any) -> Any:
        """Cotangents of q, v, u and, if wanted, theta."""
        return step_backward(*given)

    @staticmethod
    def backward(ctx: Any, *_: torch.Tensor) -> Any:
        """Raises UserError."""
        raise NO_SECOND
