"""A log as a model reads it: through biases, delay, lag and servos that lie between the log and the model's state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.unlogged import unlogged
from cmbrl.models.activations import Activations
from cmbrl.models.between.begun import begun
from cmbrl.models.between.following import followed
from cmbrl.models.between.observation import Observation
from cmbrl.models.between.wiring import Wiring
from cmbrl.models.native_step.result import StepResult
from cmbrl.scene import Scene

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions


class LogReading(ABC):
    """What a model with an ``observation`` makes of logs, and of processes that run on it."""

    scene: Scene
    time_step: float
    parameters: np.ndarray
    candidates: np.ndarray | None
    observation: dict[str, float]
    activations: Activations | None

    @property
    @abstractmethod
    def dt(self) -> float:
        """Control step [s]."""

    @abstractmethod
    def predict(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray | None = None, jacobian: bool = False
    ) -> StepResult:
        """One control step."""

    @property
    def observer(self) -> Observation:
        """What may lie between a log of this model's control step and its state."""
        return Observation.of(self.scene, self.dt, self.activations, self.time_step)

    @property
    def wiring(self) -> Wiring | None:
        """The same for a process that runs on this model; None if there is nothing between."""
        observer, sets = self.observer, self.candidates
        more = sets if sets is not None and sets.shape[1] > len(self.parameters) else None
        return Wiring.of(observer, observer.vector(self.observation), self.scene.nq, self.activations, more)

    @property
    def integral(self) -> np.ndarray | None:
        """How controls (nu, nq) change with the integral of positions [1/s]; None where no servo integrates."""
        return self.observer.integral(self.observer.vector(self.observation), self.scene.nq)

    def seen(self, log: Transitions) -> Transitions:
        """``log`` as this model's state and control, with the joints that it does not tell (``following``)."""
        free = unlogged(log, self.scene)
        theta = np.append(self.parameters, self.observer.vector(self.observation))
        observer = begun(self.observer, self, log, theta)
        psi = observer.split(theta)[1]
        state = observer.states(log, psi)
        return followed(self, state, self.parameters, free) if free else state
