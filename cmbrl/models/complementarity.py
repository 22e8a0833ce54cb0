"""The complementarity model: a scene, its time stepping and its physical parameters."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from cmbrl.contact.smoothing import Smoothing
from cmbrl.errors import UserError
from cmbrl.models import theta as physical
from cmbrl.models.activations import Activations
from cmbrl.models.between.log_reading import LogReading
from cmbrl.models.log_windows import LogWindows
from cmbrl.models.manifold import Coordinates
from cmbrl.models.native_step.autograd import check_tensors, differentiable_step
from cmbrl.models.native_step.quantities import Quantities
from cmbrl.models.native_step.result import SolverWarning, StepResult
from cmbrl.models.native_step.stepper import Stepper
from cmbrl.models.step_settings import StepSettings, read_config
from cmbrl.models.variations import Variations
from cmbrl.native import SolverStatus
from cmbrl.numbers import real_array, switch, whole
from cmbrl.scene import Scene

FAILED = int(SolverStatus.FAILED)  # an enum's member is slow to look up and to compare with


class ComplementarityModel(Variations, LogWindows, LogReading, Quantities):
    """Next-state model M (v' - v) = h (tau - bias) + J^T x with complementary contact, limits and friction.

    Args:
        scene: the world.
        substeps: physics steps in one control step.
        time_step: h [s]; default: the file's. Velocity gains in Euler files act explicitly, as in MuJoCo, and bound it.
        smoothing: :class:`Exact` (default), :class:`Barrier` or :class:`Gaussian`.
        backward_smoothing: the policy of the derivative (simulate hard, differentiate soft); default: ``smoothing``.
        integrator: "semi-implicit"; "leapfrog" (positions shifted by half a step: second order in forces that depend on
            position); or "midpoint" (leapfrog with centrifugal and gyroscopic forces half a step ahead: second order in
            all forces; derivatives cost 10 to 60 % more); or "rk4" (MuJoCo's: a contact solve at each of four stages,
            nothing implicit, rows that do not look ahead; a step takes four times as long; only for MuJoCo's contact
            law). Default: semi-implicit; where the file asks for RK4 leapfrog, or midpoint if a body may spin by
            itself.
        parameters: theta (np,) in natural units, in the order of ``scene.parameters``; default: nominal.
        threads: native threads; results do not depend on it.
        damping: "coupled" (contacts, limits, ties and dry friction feel that damping is implicit) or "split" (they act
            as if it were not, and it becomes implicit afterwards, as in MuJoCo's Euler and implicit integrators).
            Default: split for MuJoCo's contact law and these integrators at steps up to the file's; longer steps may
            diverge. Damping so strong that it overshoots 50 times (servos: 5) disturbs rows that look ahead: then
            coupled if ``look_ahead`` is True.
        sliding: "coulomb" (friction opposes sliding, nothing else; default) or "convex" (MuJoCo's law, of Anitescu and
            Potra: what slides is also lifted, until it separates with mu times its speed or as its softness lets it).
            What does not touch yet is not lifted. Only for MuJoCo's contact law. A fit of a model that leaves the
            choice open takes the law that the log supports.
        look_ahead: contacts and limits act if they would close within the step, so that nothing sinks in and the
            step has no jumps; False: once they are closed, as MuJoCo's do, and meshes touch a plane with at most four
            corners of the side towards it, as there. Only for MuJoCo's contact law. Default: where damping is split,
            False under the convex law, whose step is then MuJoCo's, and where damping is that strong; otherwise True.
        implicit_springs: treat joint springs and position gains implicitly (MuJoCo does so for velocity gains only).
        prune: contacts predicted to separate faster than this [m/s] are left out of the solve, and let in again where
            it ends otherwise; ``inf`` keeps all. Default: 3; 0.3 for a scene of many candidates, whose rows cost most.
        path_tolerance: relative distance of every complementarity product from its kappa at the solution.
        candidates: (K, np) parameter sets that explain the data about as well as ``parameters``, for training or
            evaluation under model uncertainty; stepping ignores them. (K, np + n): they end with what lies between a
            log and each of them, in the order of ``observer.parameters``.
        observation: biases, delay and lag by name (:class:`~cmbrl.models.between.observation.Observation`) that lie
            between a log and this model; stepping ignores them, ``seen`` applies them to a log, and processes on this
            model run through them (``wiring``).

    Raises:
        UserError: for a setting out of range.
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
        prune: float | None = None,
        path_tolerance: float = 1e-6,
        candidates: np.ndarray | None = None,
        observation: Mapping[str, float] | None = None,
        damping: str | None = None,
        sliding: str | None = None,
        look_ahead: bool | None = None,
    ) -> None:
        if not isinstance(scene, Scene):
            raise UserError(f"scene is a {type(scene).__name__}; give the Scene of Scene.from_mjcf")
        self.scene = scene
        self._settings = chosen = StepSettings.of(
            scene, substeps=substeps, time_step=time_step, smoothing=smoothing, integrator=integrator,
            backward_smoothing=backward_smoothing, implicit_springs=implicit_springs, damping=damping, sliding=sliding,
            look_ahead=look_ahead, prune=prune, path_tolerance=path_tolerance,
        )  # fmt: skip
        self.substeps, self.time_step, self.integrator = chosen.substeps, chosen.time_step, chosen.integrator
        self.smoothing, self.backward_smoothing = chosen.smoothing, chosen.backward_smoothing
        self.implicit_springs, self.damping = chosen.implicit_springs, chosen.damping
        self.sliding, self.look_ahead = chosen.sliding, chosen.look_ahead
        self.prune, self.path_tolerance = chosen.prune, chosen.path_tolerance
        self.threads = whole(threads, "threads", most=256)
        self.parameters = scene.parameter_vector() if parameters is None else physical.checked(scene, parameters)
        self.activations = Activations.of(
            scene, self.time_step, self.substeps, self.parameters, rk4=self.integrator == "rk4"
        )
        self.observation = dict(observation or {})
        self.observer.vector(self.observation)  # raises for an unknown name
        self.candidates = None if candidates is None else physical.checked_sets(scene, self.observer, candidates)
        self.failures = 0
        self.stepper = Stepper(scene, chosen.options(scene), self.threads)
        self.coordinates = Coordinates.from_scene(scene)

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.substeps * self.time_step

    def with_parameters(self, theta: np.ndarray | Mapping[str, float]) -> ComplementarityModel:
        """The same model with other physical parameters (np,), or some of them by name, and without candidates."""
        if isinstance(theta, Mapping):
            theta = physical.replaced(self.scene, self.parameters, theta)
        return ComplementarityModel(self.scene, parameters=theta, **{**self._arguments(), "candidates": None})

    def with_settings(self, **settings: Any) -> ComplementarityModel:
        """The same model with some arguments of the constructor replaced.

        A derivative that is that of the step stays so when ``smoothing`` changes.
        """
        scene = settings.pop("scene", self.scene)
        if "smoothing" in settings and self.backward_smoothing == self.smoothing:
            settings.setdefault("backward_smoothing", None)
        return ComplementarityModel(scene, **{"parameters": self.parameters, **self._arguments(), **settings})

    def to_config(self) -> dict[str, Any]:
        """Settings and parameters as JSON types; the scene is described by its own file."""
        parameters = physical.by_name(self.scene, self.parameters)
        own = {"threads": self.threads, "observation": self.observation, "parameters": parameters}
        return self._settings.to_config() | own

    @classmethod
    def from_config(cls, scene: Scene, config: dict[str, Any]) -> ComplementarityModel:
        """Inverse of :meth:`to_config`; raises UserError unless it names exactly the parameters of the scene."""
        config = read_config(config)
        return cls(scene, parameters=physical.from_names(scene, config.pop("parameters", {})), **config)

    def step(
        self,
        q: torch.Tensor,
        v: torch.Tensor,
        u: torch.Tensor,
        theta: torch.Tensor | None = None,
        details: dict[str, np.ndarray] | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """One control step, differentiable in q, v, u and theta by the implicit function theorem.

        Args:
            q, v, u: (B, nq), (B, nv), (B, nu) float64 CPU tensors. Where actuators have states, u (B, nu + na) ends
                with those at the start; ``activations.next`` gives those at the end.
            theta: (np,) or (B, np); default: this model's parameters.
            details: a dict that receives "impulse", as in :class:`StepResult`, without a derivative.

        Returns: q_next (B, nq), v_next (B, nv); NaN in a row whose q, v or u is not finite, and so are its gradients.
        Raises: UserError for a wrong shape or type, or a theta without a physical meaning, such as a negative mass.
        Warns SolverWarning if solves fail; ``failures`` counts them. A second derivative, as of a gradient penalty,
        raises UserError; an input changed in place before the backward pass raises torch's RuntimeError. ``torch.func``
        transforms a step by reverse and forward mode and vmap; ``torch.compile`` has to leave it out, or UserError.
        """
        check_tensors(self.scene, q, v, u, theta)
        if theta is None:
            theta = torch.from_numpy(self.parameters)
        q_next, v_next, report = differentiable_step(self.stepper, q, v, u, theta, impulse=details is not None)
        if details is not None:
            details["impulse"] = report["impulse"]
        self._count_failures(report["status"])
        return q_next, v_next

    def predict(
        self,
        q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        theta: np.ndarray | None = None,
        jacobian: bool = False,
        parameter_jacobian: bool | np.ndarray = False,
        impulse: bool = False,
    ) -> StepResult:
        """The same step on numpy arrays, with what the solver reports; theta (np,) or (B, np).

        ``parameter_jacobian``: adds columns by all parameters to the Jacobian, or by those whose numbers are given.
        Raises UserError and handles rows that are not finite as ``step`` does; Ctrl-C ends it between packs of states.
        """
        q, v, u, theta = self._arrays(theta, q=q, v=v, u=u)
        if isinstance(parameter_jacobian, np.ndarray):
            if parameter_jacobian.ndim != 1 or not np.issubdtype(parameter_jacobian.dtype, np.integer):
                raise UserError("parameter_jacobian: give numbers of parameters (k,), or True for all of them")
            columns: np.ndarray | None = np.ascontiguousarray(parameter_jacobian, dtype=np.int64)
        else:
            every = switch(parameter_jacobian, "parameter_jacobian")
            columns = np.arange(len(self.parameters)) if every else None
        jacobian, impulse = switch(jacobian, "jacobian") or columns is not None, switch(impulse, "impulse")
        out = self.stepper.forward(q, v, u, theta, jacobian=jacobian, columns=columns, impulse=impulse)
        return StepResult(**out)

    def parameter_jacobian(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q_next (N, nq), v_next (N, nv) and their derivatives in theta, (N, nv, np) each (tangent space for q)."""
        r = self.predict(q, v, u, theta, parameter_jacobian=True)
        assert r.jacobian is not None
        nv, first = self.scene.nv, 2 * self.scene.nv + self.scene.inputs
        return r.q_next, r.v_next, r.jacobian[:, :nv, first:], r.jacobian[:, nv:, first:]

    def reset_failures(self) -> None:
        """Sets ``failures`` to zero."""
        self.failures = 0

    def _arguments(self) -> dict[str, Any]:
        """Those of the constructor that give this model again, but for the scene and the parameters."""
        own = {"threads": self.threads, "candidates": self.candidates, "observation": self.observation}
        return self._settings.arguments() | own

    def _count_failures(self, status: np.ndarray) -> None:
        failed = int(np.count_nonzero(status == FAILED))
        if failed:
            self.failures += failed
            warnings.warn(
                f"{failed} of {len(status)} contact solves did not converge or started from what is not finite",
                SolverWarning,
                stacklevel=3,
            )

    def _arrays(self, theta: Any, **state: Any) -> list[np.ndarray]:
        """The state and theta as contiguous float64; raises UserError for other types, and for a state without a batch.

        The core checks other shapes.
        """
        rows = {name: real_array(value, name) for name, value in state.items()}
        if alone := [name for name, array in rows.items() if array.ndim == 1]:
            told = ", ".join(f"{name}[None]" for name in rows)
            raise UserError(f"{alone[0]} has shape {rows[alone[0]].shape}; give a batch, as {told} of one state")
        return [*rows.values(), real_array(self.parameters if theta is None else theta, "theta")]
