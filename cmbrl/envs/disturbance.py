"""What makes every episode in a model a little different: noise on velocities, and parameters of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError, did_you_mean
from cmbrl.models.between.robots import Wraps
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import HasCoordinates, Model

if TYPE_CHECKING:
    from cmbrl.scene import Scene


@dataclass(frozen=True)
class Disturbance:
    """What makes every episode in the model a little different, so that a policy cannot exploit the model's errors.

    Args:
        linear, angular: standard deviations of the noise added to velocities after each step [m/s, rad/s].
        parameters: (K, np) sets of physical parameters, or (K, np + n) with the delay, lag and biases of each, as
            ``candidates`` of a model; each episode draws one. None: the model's own.
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


def parameter_sets(
    model: Model, relative: float, count: int = 256, seed: int = 0, factors: str = ""
) -> np.ndarray | None:
    """Sets (count, np) for a ``Disturbance``: the model's candidates, each number scaled by 1 +- up to ``relative``.

    Delay, lag and biases at the end of candidates stay as they are drawn.

    Without candidates, the model's own parameters are scaled. ``factors``, such as "friction:0.5:1.5,mass:0.9:1.1",
    then multiply what a name or a group stands for: one factor a set, its logarithm even between those of the ends.
    None if there are no parameters, or nothing to vary. Raises UserError for factors that cannot be read, or that
    change nothing.
    """
    inner = model.model if isinstance(model, Wraps) else model
    if not isinstance(inner, ComplementarityModel):
        if factors:
            raise UserError(f"vary = {factors}: {model.name} has no parameters of a robot: leave it out")
        return None
    if inner.candidates is None and not relative and not factors:
        return None
    rng = np.random.default_rng(seed)
    base = inner.parameters[None] if inner.candidates is None else inner.candidates
    chosen = base[rng.integers(len(base), size=count)]
    low, high = np.array([(p.low, p.high) for p in inner.scene.parameters]).T
    chosen, between = np.split(chosen, [len(inner.parameters)], axis=1)
    chosen = chosen * (1.0 + relative * rng.uniform(-1.0, 1.0, chosen.shape))
    for columns, least, most in _factors(factors, inner.scene, inner.parameters):
        chosen[:, columns] *= np.exp(rng.uniform(np.log(least), np.log(most), (count, 1)))
    return np.hstack([np.clip(chosen, low, high), between])


def _factors(text: str, scene: Scene, theta: np.ndarray) -> list[tuple[np.ndarray, float, float]]:
    """Which parameters (np,) bool each word of ``text`` stands for, and the least and largest factor."""
    groups, found = {p.group for p in scene.parameters}, []
    for word in filter(None, (part.strip() for part in text.split(","))):
        name, *ends = word.split(":")
        columns = np.array([name in (p.name, p.group) for p in scene.parameters])
        if not columns.any():
            near = did_you_mean(name, {*groups, *(p.name for p in scene.parameters)}, listed=groups)
            raise UserError(f"vary = {word}: no parameter or group {name!r} in {scene.name}; {near}")
        try:
            low, high = (float(end) for end in ends)
        except ValueError:
            raise UserError(f"vary = {word}: give NAME:LEAST:MOST, two factors, such as friction:0.5:1.5") from None
        if not 0 < low <= high < np.inf:
            raise UserError(f"vary = {word}: the factors must be positive and finite, the least one first")
        if not theta[columns].any():
            raise UserError(f"vary = {word}: {name} is 0, which no factor changes: leave it out, or set it in the file")
        found.append((columns, low, high))
    return found
