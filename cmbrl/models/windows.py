"""Windows of a log: what a model predicts open loop, and the scales that its errors are measured in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

BLOCKS = 8  #: parts of a single episode
_SCALE_FLOOR = 1e-3  # of the largest scale of its kind, so that a coordinate that hardly moves does not dominate


@dataclass(frozen=True)
class Scales:
    """Standard deviations of the logged one-step change, q (nv,) in tangent space and v (nv,), and the Huber delta.

    An infinite scale leaves a coordinate out of the errors.
    """

    q: np.ndarray
    v: np.ndarray
    huber: float

    @classmethod
    def of(cls, scene: Scene, data: Transitions, huber: float) -> Scales:
        """The scales of ``data``; ``huber`` is the normalised residual from which errors count linearly."""
        return cls(_spread(scene.difference(data.q, data.q_next)), _spread(data.v_next - data.v), huber)

    @classmethod
    def of_positions(cls, data: Transitions, horizon: int, huber: float) -> Scales:
        """Of a log whose velocities are estimates: standard deviations of the change over ``horizon`` steps."""
        starts = data.windows(horizon)
        change = data.q_next[starts + horizon - 1] - data.q[starts]
        return cls(_spread(change), np.full(data.v.shape[1], np.inf), huber)

    @property
    def observed(self) -> int:
        """How many coordinates count."""
        return int(self.counts.sum())

    @property
    def counts(self) -> np.ndarray:
        """Mask (2 nv,) of the coordinates that count, positions first."""
        return np.isfinite(np.concatenate([self.q, self.v]))


@dataclass(frozen=True)
class Windows:
    """From each row of ``starts`` (S,), ``horizon`` steps of ``data`` under the logged controls."""

    data: Transitions
    starts: np.ndarray
    horizon: int
    scales: Scales

    def __post_init__(self) -> None:
        object.__setattr__(self, "starts", np.ascontiguousarray(self.starts, dtype=np.int64))

    @property
    def blocks(self) -> np.ndarray:
        """Block (S,) of each window; blocks are held out and resampled as a whole."""
        return blocks_of(self.data)[self.starts]

    def on(self, starts: np.ndarray) -> Windows:
        """The same windows from other ``starts``."""
        return replace(self, starts=starts)


def blocks_of(data: Transitions) -> np.ndarray:
    """Parts (N,) of a log that hardly know of each other: its episodes, or consecutive parts of a single episode."""
    return data.episode if data.n_episodes > 1 else np.arange(len(data)) * BLOCKS // max(len(data), 1)


def _spread(change: np.ndarray) -> np.ndarray:
    spread = change.std(axis=0)
    return np.maximum(spread, max(_SCALE_FLOOR * spread.max(), 1e-9))
