"""What a step of a contact model is made of: masses, forces, gaps and rows, and its contact problems."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from cmbrl.contact.problem import ContactProblem, from_rows
from cmbrl.models.native_step.stepper import Stepper
from cmbrl.scene import Scene


class Quantities(ABC):
    """Those of the model at given states."""

    scene: Scene
    stepper: Stepper
    time_step: float

    @abstractmethod
    def _arrays(self, theta: Any, **state: Any) -> list[np.ndarray]:
        """The state and theta as contiguous float64."""

    def smooth_dynamics(
        self, q: np.ndarray, v: np.ndarray, theta: np.ndarray | None = None, contacts: bool = True
    ) -> dict[str, np.ndarray]:
        """M (B, nv, nv) with armature, bias (B, nv), gap (B, nc), and rows J (B, nc, 2 or 3, nv): normal, tangents.

        Also length (B, nv + tendons) of what limits and actuators act along; 0 for the coordinates of a ball.
        ``contacts``: whether gaps and rows are wanted, which are large where many bodies could touch.
        """
        q, v, theta = self._arrays(theta, q=q, v=v)
        return self.stepper.core.dynamics(q, v, theta, self.stepper.options, contacts)

    def contact_problems(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, theta: np.ndarray | None = None
    ) -> list[ContactProblem]:
        """The contact problem of the first physics step from each state (B, ...).

        Rows: contacts that are not pruned, then joint limits as contacts with mu = 0. M includes armature and implicit
        damping; b includes the gap term, restitution, and the old velocity under a soft law. Dry joint friction has no
        row in a contact problem; v_free includes its impulse, taken from this model's own solution. With split damping
        M is without damping, and the velocity is the one that is damped afterwards. Under the convex law of sliding,
        the edges of a pyramid are contacts with mu = 0. Torsional and rolling friction are further tangents.
        """
        q, v, u, theta = self._arrays(theta, q=q, v=v, u=u)
        resolution = max(float(np.linalg.norm(self.scene.gravity)), 1e-9) * self.time_step
        rows = self.stepper.core.rows(q, v, u, theta, self.stepper.options)
        return from_rows(rows, resolution, self.scene.name)
