"""The native step and its derivative: a forward pass with a tape, a backward pass, and both as a torch function."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import torch

from cmbrl.errors import UserError
from cmbrl.native import Core, Tape
from cmbrl.scene import Scene
from cmbrl.scene.records import JointKind, Parameter

_SLACK = 1e-4  # beyond a bound, for finite differences there


class TangentMap:
    """Maps cotangents of configurations (nq) to and from their tangent space (nv).

    They differ for ball joints, whose coordinates are quaternions wxyz. A body-frame rotation d moves a unit quaternion
    by Q d / 2. Cotangents map to the tangent space by the transpose, Q^T / 2, and back by 2 Q, so that a product over
    steps is the product of the tangent Jacobians.
    """

    def __init__(self, scene: Scene) -> None:
        core = scene.core
        self.nq, self.nv = scene.nq, scene.nv
        ball = core.jnt_type == JointKind.BALL
        self.ball_q, self.ball_v = core.jnt_qadr[ball], core.jnt_vadr[ball]
        self.plain_q, self.plain_v = core.jnt_qadr[~ball], core.jnt_vadr[~ball]
        self.trivial = not ball.any()

    def to_tangent(self, q: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Tangent cotangents (B, nv) from cotangents g (B, nq) at q (B, nq)."""
        if self.trivial:
            return np.ascontiguousarray(g)
        out = np.empty((len(q), self.nv))
        out[:, self.plain_v] = g[:, self.plain_q]
        for a, d in zip(self.ball_q, self.ball_v, strict=True):
            out[:, d : d + 3] = 0.5 * np.einsum("brc,br->bc", _columns(q[:, a : a + 4]), g[:, a : a + 4])
        return out

    def to_configuration(self, q: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Cotangents (B, nq) from tangent cotangents g (B, nv) at q (B, nq)."""
        if self.trivial:
            return g
        out = np.empty((len(q), self.nq))
        out[:, self.plain_q] = g[:, self.plain_v]
        for a, d in zip(self.ball_q, self.ball_v, strict=True):
            out[:, a : a + 4] = 2.0 * np.einsum("brc,bc->br", _columns(q[:, a : a + 4]), g[:, d : d + 3])
        return out


_PLACES = np.array([[1, 2, 3], [0, 3, 2], [3, 0, 1], [2, 1, 0]])
_SIGNS = np.array([[-1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, 1.0, 1.0]])


def _columns(q: np.ndarray) -> np.ndarray:  # (B, 4, 3): q (x) (0, e_k)
    found: np.ndarray = q[:, _PLACES] * _SIGNS
    return found


class Stepper:
    """The native core of a scene with fixed settings and thread count.

    ``options`` are the core's settings by name; arrays are C-contiguous float64. :class:`ComplementarityModel` checks
    its input and owns one; call this directly only to time or inspect the native step. Copies, also by pickle, step to
    the same bits.
    """

    def __init__(self, scene: Scene, options: dict[str, Any], threads: int) -> None:
        self.scene, self.options, self.threads = scene, options, threads
        self.core = Core(scene.core.to_native(), [(p.name, *_limits(p)) for p in scene.parameters])
        self.tangent = TangentMap(scene)

    def __reduce__(self) -> tuple[Any, ...]:
        return Stepper, (self.scene, self.options, self.threads)

    @property
    def instruction_set(self) -> str:
        """The instruction set that the core runs on, and how many states it packs."""
        return f"{self.core.isa}, {self.core.width} lanes"

    def forward(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray, **wanted: Any) -> dict[str, Any]:
        """One control step from q (B, nq), v (B, nv), u (B, nu) at theta (np,) or (B, np).

        ``wanted``: extra results among tape, jacobian and impulse; columns (k,): parameters of the Jacobian.
        """
        return self.core.forward(q, v, u, theta, self.options, threads=self.threads, **wanted)

    def backward(
        self, u: np.ndarray, theta: np.ndarray, tape: Tape, gq: np.ndarray, gv: np.ndarray, want_theta: bool = False
    ) -> dict[str, np.ndarray]:
        """Tangent cotangents gq, gv (B, nv), gu (B, nu) and perhaps gtheta (B, np), from those of the next state."""
        return self.core.backward(u, theta, tape, gq, gv, self.options, want_theta, self.threads)


def _limits(p: Parameter) -> tuple[float, float]:
    """What a step accepts. The bounds of a positive parameter only say where a fit searches; others are physical."""
    if p.transform == "log":
        return 0.0, np.inf
    return p.low - _SLACK, p.high + _SLACK


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
    given = q, v, u, theta
    if torch.is_grad_enabled() and any(x.requires_grad for x in given):
        report: dict[str, np.ndarray] = {}
        q_next, v_next = NativeStep.apply(*given, stepper, report, impulse)
        return q_next, v_next, report
    out = stepper.forward(*map(_array, given), impulse=impulse)
    return torch.from_numpy(out["q_next"]), torch.from_numpy(out["v_next"]), out


def _array(x: torch.Tensor) -> np.ndarray:
    """C-contiguous, without a copy if it is so already."""
    return np.ascontiguousarray((x.detach() if x.requires_grad else x).numpy())


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
        arrays = [_array(x) for x in (q, v, u, theta)]
        record = any(ctx.needs_input_grad[:4])
        out = stepper.forward(*arrays, tape=record, impulse=impulse)
        report.update(out)
        q_next, v_next = torch.from_numpy(out["q_next"]), torch.from_numpy(out["v_next"])
        if record:
            ctx.stepper, ctx.tape = stepper, out["tape"]
            end = () if stepper.tangent.trivial else (q_next,)
            ctx.save_for_backward(q, v, u, theta, *end)  # torch notices if one of them is changed in place
        return q_next, v_next

    @staticmethod
    def backward(ctx: Any, gq_next: torch.Tensor, gv_next: torch.Tensor) -> Any:  # type: ignore[override]
        """Vector-Jacobian product from the tape."""
        q, v, u, theta, *end = ctx.saved_tensors
        q_next = end[0].detach() if end else None
        # Gradients are on here under create_graph only. Otherwise a second function would add a tenth for nothing.
        product = _Gradient.apply if torch.is_grad_enabled() else partial(_Gradient.forward, None)
        gradients = product(q, v, u, theta, gq_next, gv_next, q_next, ctx.stepper, ctx.tape, ctx.needs_input_grad[3])
        return *gradients, None, None, None


class _Gradient(torch.autograd.Function):
    """The backward pass of :class:`NativeStep` as a function of its own, so that a second derivative is refused.

    Under ``create_graph=True`` the gradient of a step stands in a graph. What goes through it again would be lost
    without a word if the gradient were a constant there.
    """

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        q: torch.Tensor,
        v: torch.Tensor,
        u: torch.Tensor,
        theta: torch.Tensor,
        gq_next: torch.Tensor,
        gv_next: torch.Tensor,
        q_next: torch.Tensor | None,
        stepper: Stepper,
        tape: Tape,
        want_theta: bool,
    ) -> Any:
        """Cotangents of q, v, u and, if wanted, theta; q_next (B, nq) is needed for ball joints only."""
        q_, q_next_, u_, theta_, gq_, gv_ = map(
            _array, (q, q if q_next is None else q_next, u, theta, gq_next, gv_next)
        )
        out = stepper.backward(u_, theta_, tape, stepper.tangent.to_tangent(q_next_, gq_), gv_, want_theta)
        gtheta = None
        if want_theta:
            gtheta = torch.from_numpy(out["gtheta"])
            if theta.ndim == 1:
                gtheta = gtheta.sum(0)
        gq = torch.from_numpy(stepper.tangent.to_configuration(q_, out["gq"]))
        return gq, torch.from_numpy(out["gv"]), torch.from_numpy(out["gu"]), gtheta

    @staticmethod
    def backward(ctx: Any, *_: torch.Tensor) -> Any:  # type: ignore[override]
        """Raises UserError."""
        raise UserError(
            "a contact step has first derivatives only: leave out create_graph=True, or detach the gradient of the step"
        )
