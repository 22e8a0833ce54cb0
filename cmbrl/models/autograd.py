"""The native step as one torch.autograd.Function: forward keeps a tape, backward is one native call."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from cmbrl.scene import Scene

if TYPE_CHECKING:
    from cmbrl.models.complementarity import ComplementarityModel


class TangentMap:
    """Cotangents of a configuration (nq) <-> of its tangent space (nv), where ball joints carry quaternions wxyz.

    A body-frame rotation d moves a unit quaternion by Q d / 2; cotangents map by the transpose there and by 2 Q^T back,
    so that the product over steps is the product of the tangent Jacobians.
    """

    def __init__(self, scene: Scene) -> None:
        core = scene.core
        self.nq, self.nv = scene.nq, scene.nv
        ball = core.jnt_type == 2
        self.ball_q, self.ball_v = core.jnt_qadr[ball], core.jnt_vadr[ball]
        self.plain_q, self.plain_v = core.jnt_qadr[~ball], core.jnt_vadr[~ball]
        self.trivial = not ball.any()

    def to_tangent(self, q: np.ndarray, g: np.ndarray) -> np.ndarray:
        """(B, nv) from a cotangent g (B, nq) at q (B, nq)."""
        if self.trivial:
            return np.ascontiguousarray(g)
        out = np.empty((len(q), self.nv))
        out[:, self.plain_v] = g[:, self.plain_q]
        for a, d in zip(self.ball_q, self.ball_v, strict=True):
            out[:, d : d + 3] = 0.5 * np.einsum("brc,br->bc", _columns(q[:, a : a + 4]), g[:, a : a + 4])
        return out

    def to_configuration(self, q: np.ndarray, g: np.ndarray) -> np.ndarray:
        """(B, nq) from a tangent cotangent g (B, nv) at q."""
        if self.trivial:
            return g
        out = np.empty((len(q), self.nq))
        out[:, self.plain_q] = g[:, self.plain_v]
        for a, d in zip(self.ball_q, self.ball_v, strict=True):
            out[:, a : a + 4] = 2.0 * np.einsum("brc,bc->br", _columns(q[:, a : a + 4]), g[:, d : d + 3])
        return out


def tangent_map(scene: Scene) -> TangentMap:
    """The map of a scene's configurations."""
    return TangentMap(scene)


def _columns(q: np.ndarray) -> np.ndarray:  # (B, 4, 3): q (x) (0, e_k)
    w, x, y, z = q.T
    rows = ([-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w])
    return np.stack([np.stack(row, 1) for row in rows], 1)


class NativeStep(torch.autograd.Function):
    """(q, v, u, theta) -> (q_next, v_next) of a ComplementarityModel."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        q: torch.Tensor,
        v: torch.Tensor,
        u: torch.Tensor,
        theta: torch.Tensor,
        model: ComplementarityModel,
        details: dict[str, np.ndarray] | None = None,
    ) -> Any:
        """Runs the native step, with its tape if a gradient may be asked for; puts impulses into ``details``."""
        arrays = [x.detach().contiguous().numpy() for x in (q, v, u, theta)]
        record = any(ctx.needs_input_grad[:4])
        out = model._core.forward(
            *arrays, model._options, tape=record, impulse=details is not None, threads=model.threads
        )
        if details is not None:
            details["impulse"] = out["impulse"]
        model._count_failures(out["status"])
        if record:
            ctx.model, ctx.arrays, ctx.tape, ctx.q_next = model, arrays, out["tape"], out["q_next"]
        return torch.from_numpy(out["q_next"]), torch.from_numpy(out["v_next"])

    @staticmethod
    def backward(ctx: Any, gq_next: torch.Tensor, gv_next: torch.Tensor) -> Any:  # type: ignore[override]
        """Vector-Jacobian product from the tape."""
        q, _, u, theta = ctx.arrays
        model, tangent = ctx.model, ctx.model._tangent
        want_theta = ctx.needs_input_grad[3]
        gq_next = tangent.to_tangent(ctx.q_next, gq_next.contiguous().numpy())
        out = model._core.backward(
            u, theta, ctx.tape, gq_next, gv_next.contiguous().numpy(), model._options, want_theta, model.threads
        )
        gtheta = None
        if want_theta:
            gtheta = torch.from_numpy(out["gtheta"])
            if theta.ndim == 1:
                gtheta = gtheta.sum(0)
        gq = torch.from_numpy(tangent.to_configuration(q, out["gq"]))
        return gq, torch.from_numpy(out["gv"]), torch.from_numpy(out["gu"]), gtheta, None, None
