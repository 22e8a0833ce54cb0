"""The native step and its derivative on arrays and on tensors without a graph: a pass with a tape, and one back."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from cmbrl.errors import UserError
from cmbrl.native import Core, Tape
from cmbrl.scene import Scene
from cmbrl.scene.records import JointKind, Parameter

NO_SECOND = UserError(
    "a contact step has first derivatives only: leave out create_graph=True, or detach the gradient of the step"
)
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

    def in_configurations(self, q: np.ndarray, q_next: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
        """The Jacobian (B, nq + nv, nq + ...) of a step from q to q_next (B, nq), from that in tangent space."""
        if self.trivial:
            return jacobian
        count, nv = len(q), self.nv
        enter, leave = np.zeros((count, nv, self.nq)), np.zeros((count, self.nq, nv))
        enter[:, self.plain_v, self.plain_q] = leave[:, self.plain_q, self.plain_v] = 1.0
        for a, d in zip(self.ball_q, self.ball_v, strict=True):
            enter[:, d : d + 3, a : a + 4] = 2.0 * _columns(q[:, a : a + 4]).transpose(0, 2, 1)
            leave[:, a : a + 4, d : d + 3] = 0.5 * _columns(q_next[:, a : a + 4])
        wide = np.concatenate([jacobian[:, :, :nv] @ enter, jacobian[:, :, nv:]], axis=2)
        return np.concatenate([leave @ wide[:, :nv], wide[:, nv:]], axis=1)


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


class SplitStepper(Stepper):
    """Steps the last ``share`` of the rows of every batch by ``other``, the first ones by ``own``.

    Both are of one scene and one control step, and differ in their settings.
    """

    def __init__(self, own: Stepper, other: Stepper, share: float) -> None:
        vars(self).update(vars(own))  # its core serves what is not stepped; another would take its time to build
        self.own, self.other, self.share = own, other, share

    def __reduce__(self) -> tuple[Any, ...]:
        return SplitStepper, (self.own, self.other, self.share)

    def forward(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray, **wanted: Any) -> dict[str, Any]:
        """As a ``Stepper``; the tape is that of each part."""
        found = [s.forward(q[r], v[r], u[r], _of_rows(theta, r), **wanted) for s, r in self._parts(len(q))]
        tapes = [part.pop("tape", None) for part in found]
        out: dict[str, Any] = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
        return out | ({"tape": tapes} if wanted.get("tape") else {})

    def backward(
        self, u: np.ndarray, theta: np.ndarray, tape: Any, gq: np.ndarray, gv: np.ndarray, want_theta: bool = False
    ) -> dict[str, np.ndarray]:
        """As a ``Stepper``."""
        found = [
            s.backward(u[r], _of_rows(theta, r), part, gq[r], gv[r], want_theta)
            for (s, r), part in zip(self._parts(len(u)), tape, strict=True)
        ]
        return {name: np.concatenate([part[name] for part in found]) for name in found[0]}

    def _parts(self, count: int) -> list[tuple[Stepper, slice]]:
        """The steppers that have rows among ``count``, and which."""
        first = count - round(self.share * count)
        parts = [(self.own, slice(None, first)), (self.other, slice(first, None))]
        return [(stepper, rows) for stepper, rows in parts if len(range(count)[rows])] or parts[:1]


def _of_rows(theta: np.ndarray, rows: slice) -> np.ndarray:
    return theta[rows] if theta.ndim == 2 else theta


def _limits(p: Parameter) -> tuple[float, float]:
    """What a step accepts. The bounds of a positive parameter only say where a fit searches; others are physical."""
    if p.transform == "log":
        return 0.0, np.inf
    return p.low - _SLACK, p.high + _SLACK


def step_forward(
    q: torch.Tensor,
    v: torch.Tensor,
    u: torch.Tensor,
    theta: torch.Tensor,
    stepper: Stepper,
    report: dict[str, Any],
    impulse: bool,
    record: bool,
) -> tuple[torch.Tensor, torch.Tensor]:
    """q_next and v_next; the core's other results, and a tape if it is to ``record`` one, go into ``report``."""
    report.update(stepper.forward(*map(plain, (q, v, u, theta)), tape=record, impulse=impulse))
    return torch.from_numpy(report["q_next"]), torch.from_numpy(report["v_next"])


def step_backward(
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
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor | None]:
    """Cotangents of q, v, u and, if wanted, theta; q_next (B, nq) is needed for ball joints only."""
    q_, q_next_, u_, theta_, gq_, gv_ = map(plain, (q, q if q_next is None else q_next, u, theta, gq_next, gv_next))
    out = stepper.backward(u_, theta_, tape, stepper.tangent.to_tangent(q_next_, gq_), gv_, want_theta)
    gtheta = None
    if want_theta:
        gtheta = torch.from_numpy(out["gtheta"])
        if theta.ndim == 1:
            gtheta = gtheta.sum(0)
    gq = torch.from_numpy(stepper.tangent.to_configuration(q_, out["gq"]))
    return gq, torch.from_numpy(out["gv"]), torch.from_numpy(out["gu"]), gtheta


def plain(x: torch.Tensor) -> np.ndarray:
    """C-contiguous, without a copy if it is so already."""
    return np.ascontiguousarray((x.detach() if x.requires_grad else x).numpy())
