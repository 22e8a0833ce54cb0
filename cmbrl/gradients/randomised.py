"""Randomised smoothing of the step's derivative: the sampled counterpart of barrier smoothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.manifold import Coordinates
from cmbrl.models.native_step.stepper import TangentMap
from cmbrl.native import SolverStatus


class RandomisedModel:
    """Steps like ``model``; its derivative is the mean Jacobian at ``samples`` perturbed states and controls.

    First-order bundle of the dynamics, A, B = mean of d f(x + dx, u + du) (Suh, Pang & Tedrake, "Bundled gradients
    through contact via randomized smoothing", RA-L 2022). Each evaluation costs 1 + ``samples`` steps.

    Args:
        model: what is stepped, with its own smoothing (usually hard).
        samples: size of the bundle, at least 1.
        position, velocity, control: standard deviations in units of the coordinates (m, rad; per second).
        seed: of the noise; all calls draw from one stream.

    Raises:
        UserError: for an empty bundle or one without noise.
    """

    def __init__(
        self,
        model: ComplementarityModel,
        samples: int,
        position: float = 0.0,
        velocity: float = 0.0,
        control: float = 0.0,
        seed: int = 0,
    ) -> None:
        if samples < 1 or not max(position, velocity, control) > 0 or min(position, velocity, control) < 0:
            raise UserError(
                f"bundle of {samples} samples, noise {position}, {velocity}, {control}: give some of each, none below 0"
            )
        self.model, self.samples = model, samples
        self.coordinates = Coordinates.from_scene(model.scene)
        self.noise = (position, velocity, control)
        self.failures = self.steps = 0  #: of the whole bundle
        self._rng = np.random.default_rng(seed)

    @property
    def name(self) -> str:
        """The model's name with the size of the bundle."""
        return f"{self.model.name}, bundle of {self.samples}"

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.model.dt

    def reset_failures(self) -> None:
        """Sets the count of failed solves to zero."""
        self.failures = 0

    def state(self) -> dict[str, Any]:
        """What the next step depends on."""
        return {"rng": self._rng.bit_generator.state, "steps": self.steps}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self._rng.bit_generator.state, self.steps = state["rng"], state["steps"]

    def step(self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv), float64, differentiable in q (B, nq), v (B, nv) and u (B, nu).

        Not in the physical parameters theta (np,) or (B, np), which are constants.
        """
        return _Bundle.apply(q, v, u, self, None if theta is None else theta.detach().numpy())

    def mean_jacobian(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray | None = None) -> np.ndarray:
        """(B, 2 nv, 2 nv + nu), tangent space for q; steps that fail are left out of the mean and counted."""
        total: np.ndarray | float = 0.0
        count = np.zeros(len(q))
        self.steps += self.samples * len(q)
        for _ in range(self.samples):
            dq, dv, du = (
                std * self._rng.normal(size=(len(q), width))
                for std, width in zip(self.noise, (v.shape[1], v.shape[1], u.shape[1]), strict=True)
            )
            r = self.model.predict(self.model.scene.integrate(q, dq), v + dv, u + du, theta, jacobian=True)
            assert r.jacobian is not None
            solved = r.status != SolverStatus.FAILED
            self.failures += int((~solved).sum())
            total = total + np.where(solved[:, None, None], r.jacobian, 0.0)
            count += solved
        with np.errstate(invalid="ignore"):
            return np.asarray(total / count[:, None, None])  # NaN where all failed


class _Bundle(torch.autograd.Function):
    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, q: Tensor, v: Tensor, u: Tensor, bundle: RandomisedModel, theta: np.ndarray | None
    ) -> Any:
        here = (q.detach().numpy(), v.detach().numpy(), u.detach().numpy())
        r = bundle.model.predict(*here, theta)
        bundle.steps += len(here[0])
        bundle.failures += int((r.status == SolverStatus.FAILED).sum())
        if any(ctx.needs_input_grad[:3]):
            ctx.jacobian = bundle.mean_jacobian(*here, theta)
            ctx.scene, ctx.q, ctx.q_next = bundle.model.scene, here[0], r.q_next
        return torch.from_numpy(r.q_next), torch.from_numpy(r.v_next)

    @staticmethod
    def backward(ctx: Any, gq: Tensor, gv: Tensor) -> Any:  # type: ignore[override]
        tangent, nv = TangentMap(ctx.scene), ctx.scene.nv
        cotangent = np.concatenate([tangent.to_tangent(ctx.q_next, gq.numpy()), gv.numpy()], axis=1)
        back = np.einsum("bi,bij->bj", cotangent, ctx.jacobian)
        back_q = tangent.to_configuration(ctx.q, np.ascontiguousarray(back[:, :nv]))
        return (
            torch.from_numpy(back_q),
            torch.from_numpy(back[:, nv : 2 * nv]),
            torch.from_numpy(back[:, 2 * nv :]),
            None,
            None,
        )
