"""A model as a system: one robot that acts, moved by the model and drawn by MuJoCo."""

from __future__ import annotations

import warnings

import numpy as np
import torch

from cmbrl.envs.system import MujocoSystem
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel, SolverWarning
from cmbrl.models.protocol import Model


class ModelSystem:
    """``model`` as a :class:`cmbrl.envs.system.System`; solves that fail are counted in ``model.failures``."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._q, self._v = np.empty(0), np.empty(0)
        self._view: MujocoSystem | None = None

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return self.model.dt

    def reset(self, q: np.ndarray, v: np.ndarray) -> None:
        """Takes the state q (nq,), v (nv,)."""
        self._q, self._v = np.array(q, dtype=np.float64), np.array(v, dtype=np.float64)

    @torch.no_grad()
    def step(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One step of the model with the control u (nu,)."""
        arrays = (np.array(x, dtype=np.float64)[None] for x in (self._q, self._v, u))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SolverWarning)
            q, v = self.model.step(*map(torch.from_numpy, arrays))
        self._q, self._v = q[0].numpy(), v[0].numpy()
        return self._q, self._v

    def render(self, width: int = 480, height: int = 360) -> np.ndarray:
        """A picture of the present state in the scene's MJCF; raises UserError for a model without one."""
        if not isinstance(self.model, ComplementarityModel):
            raise UserError(f"a model of kind {self.model.name!r} has no scene to draw: use the nominal model or a fit")
        if self._view is None:
            self._view = MujocoSystem(self.model.scene.path)
        self._view.reset(self._q, self._v)
        return self._view.render(width, height)
