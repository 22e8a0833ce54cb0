"""The complementarity model: a scene, how it is stepped, and the physical parameters it is stepped with."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from cmbrl.contact import smoothing as smoothing_policies
from cmbrl.contact.problem import ContactProblem, from_rows
from cmbrl.contact.smoothing import Exact, Smoothing
from cmbrl.errors import UserError
from cmbrl.models.autograd import NativeStep, tangent_map
from cmbrl.native import Core
from cmbrl.scene import Scene

INTEGRATORS = ("semi-implicit", "leapfrog", "midpoint")
FAILURE_LOSS = 1e3  # what a failed solve adds to a candidate's loss


class SolverWarning(RuntimeWarning):
    """Some contact solves of a batch did not converge; their results are flagged in ``StepResult.status``."""


@dataclass(frozen=True)
class StepResult:
    """What one batched step returned, numpy.

    q_next (B, nq), v_next (B, nv); status (B,) 0 converged, 1 by the compliant fallback, 2 failed; iterations (B,)
    summed over substeps; residual (B,) worst relative residual over substeps; jacobian (B, 2 nv, 2 nv + nu [+ np]) of
    (q', v') in (q, v, u [, theta]), tangent space for q, where asked for; impulse (B, contacts, 2 or 3) [N s] along
    the rows of ``smooth_dynamics``, summed over substeps, where asked for.
    """

    q_next: np.ndarray
    v_next: np.ndarray
    status: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray | None = None
    impulse: np.ndarray | None = None


class ComplementarityModel:
    """Next-state model M (v' - v) = h (tau - bias) + J^T x with complementary contact, limits and friction.

    Args:
        scene: what is in the world.
        substeps: physics steps in one control step.
        time_step: h [s]; default the scene's.
        smoothing: :class:`Exact` (default), :class:`Barrier` or :class:`Adaptive`.
        backward_smoothing: the policy of the derivative where it differs (simulate hard, differentiate soft).
        integrator: "semi-implicit"; "leapfrog" (positions shifted by half a step: second order for forces of position);
            "midpoint" (the same with centrifugal and gyroscopic forces half a step ahead: second order for all of them;
            derivatives cost 10 to 60 % more). Default leapfrog for an MJCF with RK4, else semi-implicit.
        parameters: theta (np,), natural units, order of ``scene.parameters``; default nominal.
        threads: native threads; results do not depend on it.
        implicit_springs: take joint springs and position gains implicitly too (MuJoCo takes only velocity gains).
        prune: rows predicted to separate faster than this [m/s] are left out of the solve; ``inf`` keeps all.
        path_tolerance: how near every complementarity product is brought to its kappa, relative to it.
        candidates: (K, np) sets of parameters that explain what is known about as well as ``parameters`` do, for who
            trains or judges under the model's uncertainty; stepping does not look at them.

    Raises:
        UserError: for a setting out of its range.
    """

    name = "complementarity"

    def __init__(
        self,
        scene: Scene,
        substeps: int = 1,
        time_step: float | None = None,
        smoothing: Smoothing | None = None,
        integrator: str | None = None,
        parameters: np.ndarray | None = None,
        threads: int = 1,
        backward_smoothing: Smoothing | None = None,
        implicit_springs: bool = False,
        prune: float = 3.0,
        path_tolerance: float = 1e-6,
        candidates: np.ndarray | None = None,
    ) -> None:
        self.scene = scene
        self.substeps = int(substeps)
        self.time_step = float(scene.timestep if time_step is None else time_step)
        self.integrator = integrator or ("leapfrog" if scene.integrator == "rk4" else "semi-implicit")
        self.smoothing = smoothing or Exact()
        self.backward_smoothing = backward_smoothing or self.smoothing
        self.threads = int(threads)
        self.implicit_springs = bool(implicit_springs)
        self.prune = float(prune)
        self.path_tolerance = float(path_tolerance)
        if self.substeps < 1 or not self.time_step > 0:
            raise UserError(f"substeps = {substeps}, time_step = {self.time_step}: both must be positive")
        if self.integrator not in INTEGRATORS:
            raise UserError(f"unknown integrator {self.integrator!r}: use one of {', '.join(INTEGRATORS)}")
        self.parameters = self._checked_parameters(parameters)
        self.candidates = None if candidates is None else np.array([self._checked_parameters(x) for x in candidates])
        self.failures = 0
        self._core = Core(scene.core.to_native())
        self._options = {
            "h": self.time_step,
            "substeps": self.substeps,
            "leapfrog": int(self.integrator != "semi-implicit"),
            "midpoint": int(self.integrator == "midpoint"),
            "implicit_springs": int(self.implicit_springs),
            "forward": self.smoothing.resolve(scene, self.time_step),
            "backward": self.backward_smoothing.resolve(scene, self.time_step),
            "prune": self.prune,
            "tolerance": 1e-9,
            "theta": self.path_tolerance,
            "max_iterations": 40,
            "rest_speed": 3 * 9.81 * self.time_step,
        }
        self._tangent = tangent_map(scene)

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.substeps * self.time_step

    def with_parameters(self, theta: np.ndarray) -> ComplementarityModel:
        """The same model with other physical parameters (np,), and no candidates beside them."""
        return ComplementarityModel(self.scene, parameters=theta, **{**self._settings(), "candidates": None})

    def with_settings(self, **settings: Any) -> ComplementarityModel:
        """The same model with some constructor settings replaced."""
        return ComplementarityModel(self.scene, **{"parameters": self.parameters, **self._settings(), **settings})

    def to_config(self) -> dict[str, Any]:
        """JSON-able settings and parameters (without the scene, which its own file describes)."""
        settings = self._settings()
        del settings["candidates"]  # the folder of the fit has them
        for key in ("smoothing", "backward_smoothing"):
            settings[key] = smoothing_policies.to_config(settings[key])
        names = [p.name for p in self.scene.parameters]
        return {**settings, "parameters": dict(zip(names, self.parameters.tolist(), strict=True))}

    @classmethod
    def from_config(cls, scene: Scene, config: dict[str, Any]) -> ComplementarityModel:
        """Inverse of :meth:`to_config`; raises UserError when the config names a parameter the scene does not have."""
        config = dict(config)
        values = config.pop("parameters", {})
        known = {p.name: i for i, p in enumerate(scene.parameters)}
        theta = scene.parameter_vector()
        for name, value in values.items():
            if name not in known:
                raise UserError(
                    f"{name!r} is no parameter of scene {scene.name!r}: was the model fitted on another one?"
                )
            theta[known[name]] = value
        for key in ("smoothing", "backward_smoothing"):
            if key in config:
                config[key] = smoothing_policies.from_config(config[key])
        return cls(scene, parameters=theta, **config)

    def step(
        self,
        q: torch.Tensor,
        v: torch.Tensor,
        u: torch.Tensor,
        theta: torch.Tensor | None = None,
        details: dict[str, np.ndarray] | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """One control step, differentiable in q, v, u and theta by the implicit function theorem.

        Args: q (B, nq), v (B, nv), u (B, nu) float64 CPU tensors; theta (np,) or (B, np), default this model's own;
            details: filled with "impulse", as in :class:`StepResult`, without derivative.
        Returns: q_next (B, nq), v_next (B, nv).
        Raises: UserError for a wrong shape or type. Warns SolverWarning when solves fail; ``failures`` counts them.
        """
        self._check_tensor(q, "q", self.scene.nq)
        self._check_tensor(v, "v", self.scene.nv)
        self._check_tensor(u, "u", self.scene.nu)
        if not len(q) == len(v) == len(u):
            raise UserError(f"q, v, u have {len(q)}, {len(v)}, {len(u)} rows: give one row per element of the batch")
        count = len(self.parameters)
        if theta is None:
            theta = torch.from_numpy(self.parameters)
        elif theta.dtype != torch.float64 or theta.shape not in ((count,), (len(q), count)):
            raise UserError(f"theta is {theta.dtype} {tuple(theta.shape)}: give float64 ({count},) or (batch, {count})")
        return NativeStep.apply(q, v, u, theta, self, details)

    def predict(
        self,
        q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        theta: np.ndarray | None = None,
        jacobian: bool = False,
        parameter_jacobian: bool = False,
        impulse: bool = False,
    ) -> StepResult:
        """The same step on numpy arrays with everything the solver reports; theta (np,) or (B, np)."""
        arrays = [np.ascontiguousarray(x, dtype=np.float64) for x in (q, v, u)]
        theta = np.ascontiguousarray(self.parameters if theta is None else theta, dtype=np.float64)
        out = self._core.forward(
            *arrays, theta, self._options, jacobian=jacobian or parameter_jacobian, jacobian_theta=parameter_jacobian,
            impulse=impulse, threads=self.threads,
        )  # fmt: skip
        if impulse and (jacobian or parameter_jacobian):  # the core keeps impulses on its pass without Jacobians only
            out["impulse"] = self._core.forward(*arrays, theta, self._options, impulse=True, threads=self.threads)[
                "impulse"
            ]
        return StepResult(**out)

    def parameter_jacobian(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q_next (N, nq), v_next (N, nv) and their derivatives in theta, (N, nv, np) each (tangent space for q)."""
        r = self.predict(q, v, u, theta, parameter_jacobian=True)
        assert r.jacobian is not None
        nv, first = self.scene.nv, 2 * self.scene.nv + self.scene.nu
        return r.q_next, r.v_next, r.jacobian[:, :nv, first:], r.jacobian[:, nv:, first:]

    def candidate_loss(
        self,
        q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        q_next: np.ndarray,
        v_next: np.ndarray,
        starts: np.ndarray,
        horizon: int,
        theta: np.ndarray,
        scale_q: np.ndarray,
        scale_v: np.ndarray,
        huber: float,
    ) -> np.ndarray:
        """Mean loss (C,) of parameter candidates theta (C, np) in one native batch.

        From every row in ``starts`` the logged controls are rolled ``horizon`` steps open loop; per step the Huber loss
        of (prediction - log)/scale is summed over coordinates. A failed solve adds a large constant.
        """
        arrays = [np.ascontiguousarray(x, dtype=np.float64) for x in (q, v, u, q_next, v_next)]
        theta, scale_q, scale_v = (np.ascontiguousarray(x, dtype=np.float64) for x in (theta, scale_q, scale_v))
        starts = np.ascontiguousarray(starts, dtype=np.int64)
        losses = self._core.loss(
            *arrays,
            starts,
            int(horizon),
            theta,
            scale_q,
            scale_v,
            float(huber),
            FAILURE_LOSS,
            self._options,
            self.threads,
        )
        return losses.mean(axis=1) / horizon

    def smooth_dynamics(self, q: np.ndarray, v: np.ndarray, theta: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """M (B, nv, nv) with armature, bias (B, nv), gap (B, nc), rows J (B, nc, 2 or 3, nv): normal, tangents."""
        theta = self.parameters if theta is None else theta
        q, v, theta = (np.ascontiguousarray(x, dtype=np.float64) for x in (q, v, theta))
        return self._core.dynamics(q, v, theta, self._options)

    def contact_problems(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray | None = None
    ) -> list[ContactProblem]:
        """What the first physics step from each state (B, ...) asks of its contacts, as problems on their own.

        Rows: contacts that are not pruned, then joint limits as contacts with mu = 0. M has armature and implicit
        damping in it; b the gap term, restitution and what a soft law carries of the old velocity. Dry friction of
        joints has no row in a contact problem: it is part of v_free, with the impulse of this model's own solution.
        """
        theta = self.parameters if theta is None else theta
        q, v, u, theta = (np.ascontiguousarray(x, dtype=np.float64) for x in (q, v, u, theta))
        gravity = self.scene.core.P[-(2 if self.scene.planar else 3) :]
        resolution = max(float(np.linalg.norm(gravity)), 1e-9) * self.time_step
        return from_rows(self._core.rows(q, v, u, theta, self._options), resolution, self.scene.name)

    def reset_failures(self) -> None:
        """Start counting failed solves anew."""
        self.failures = 0

    def _settings(self) -> dict[str, Any]:
        return {
            "substeps": self.substeps,
            "time_step": self.time_step,
            "smoothing": self.smoothing,
            "integrator": self.integrator,
            "threads": self.threads,
            "backward_smoothing": self.backward_smoothing,
            "implicit_springs": self.implicit_springs,
            "prune": self.prune,
            "path_tolerance": self.path_tolerance,
            "candidates": self.candidates,
        }

    def _count_failures(self, status: np.ndarray) -> None:
        failed = int((status == 2).sum())
        if failed:
            self.failures += failed
            warnings.warn(f"{failed} of {len(status)} contact solves did not converge", SolverWarning, stacklevel=4)

    def _checked_parameters(self, theta: np.ndarray | None) -> np.ndarray:
        if theta is None:
            return self.scene.parameter_vector()
        theta = np.array(theta, dtype=np.float64)
        if theta.shape != (len(self.scene.parameters),):
            raise UserError(f"parameters have shape {theta.shape}: the scene has {len(self.scene.parameters)}")
        for p, x in zip(self.scene.parameters, theta, strict=True):
            if not p.low <= x <= p.high:
                raise UserError(f"parameter {p.name} = {x:g} is outside its bounds [{p.low:g}, {p.high:g}]")
        return theta

    def _check_tensor(self, x: torch.Tensor, name: str, width: int) -> None:
        if x.dtype != torch.float64 or x.ndim != 2 or x.shape[1] != width:
            raise UserError(f"{name} is {x.dtype} {tuple(x.shape)}: give float64 of shape (batch, {width})")
