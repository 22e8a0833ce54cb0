"""What makes every episode in a model a little different: noise on velocities, and parameters of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import HasCoordinates, Model
from cmbrl.models.wiring import Wraps


@dataclass(frozen=True)
class Disturbance:
    """What makes every episode in the model a little different, so that a policy cannot exploit the model's errors.

    Args:
        linear, angular: standard deviations of the noise added to velocities after each step [m/s, rad/s].
        parameters: (K, np) sets of physical parameters; each episode draws one. None: the model's own.
    """

    linear: float = 0.0
    angular: float = 0.0
    parameters: np.ndarray | None = None

    def noise_scale(self, model: Model) -> Tensor | None:
        """(nv,) standard deviation of the velocity noise; None without noise.

        Raises UserError for a model that does not know which velocities are linear and which angular.
        """
        if not (self.linear or self.angular):
            return None
        if not isinstance(model, HasCoordinates):
            raise UserError(
                f"{model.name} has no coordinates, which velocity noise needs; set noise_linear and noise_angular to 0"
            )
        coordinates = model.coordinates
        scale = torch.full((coordinates.nv,), self.angular, dtype=torch.float64)
        scale[list(coordinates.slides_v)] = self.linear
        return scale


def parameter_sets(model: Model, relative: float, count: int = 256, seed: int = 0) -> np.ndarray | None:
    """Sets (count, np) for a ``Disturbance``: the model's candidates, each number scaled by 1 +- up to ``relative``.

    Without candidates, the model's own parameters are scaled. None if there are no parameters, or nothing to vary.
    """
    inner = model.model if isinstance(model, Wraps) else model
    if not isinstance(inner, ComplementarityModel) or (inner.candidates is None and not relative):
        return None
    rng = np.random.default_rng(seed)
    base = inner.parameters[None] if inner.candidates is None else inner.candidates
    chosen = base[rng.integers(len(base), size=count)]
    low, high = np.array([(p.low, p.high) for p in inner.scene.parameters]).T
    return np.clip(chosen * (1.0 + relative * rng.uniform(-1.0, 1.0, chosen.shape)), low, high)
