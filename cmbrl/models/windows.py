"""Windows of a log: what a model predicts open loop, and the scales that its errors are measured in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

_SCALE_FLOOR = 1e-3  # of the largest scale of its kind, so that a coordinate that hardly moves does not dominate


@dataclass(frozen=True)
class Scales:
    """Standard deviations of the logged one-step change, q (nv,) in tangent space and v (nv,), and the Huber delta."""

    q: np.ndarray
    v: np.ndarray
    huber: float

    @classmethod
    def of(cls, scene: Scene, data: Transitions, huber: float) -> Scales:
        """The scales of ``data``; ``huber`` is the normalised residual from which errors count linearly."""
        return cls(_spread(scene.difference(data.q, data.q_next)), _spread(data.v_next - data.v), huber)


@dataclass(frozen=True)
class Windows:
    """From each row of ``starts`` (S,), ``horizon`` steps of ``data`` under the logged controls."""

    data: Transitions
    starts: np.ndarray
    horizon: int
    scales: Scales

    def __post_init__(self) -> None:
        object.__setattr__(self, "starts", np.ascontiguousarray(self.starts, dtype=np.int64))

    def on(self, starts: np.ndarray) -> Windows:
        """The same windows from other ``starts``."""
        return replace(self, starts=starts)


def _spread(change: np.ndarray) -> np.ndarray:
    spread = change.std(axis=0)
    return np.maximum(spread, max(_SCALE_FLOOR * spread.max(), 1e-9))
