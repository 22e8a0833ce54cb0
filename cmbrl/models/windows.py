"""Windows of a log: what a model predicts open loop, and the scales that its errors are measured in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

BLOCKS = 8  #: parts of a single episode
_MODEL_SHARE = 0.25  # of the change: about what a contact model leaves; sensor noise is weighed against it
_SCALE_FLOOR = 1e-3  # of the largest scale of its kind, so that a coordinate that hardly moves does not dominate


@dataclass(frozen=True)
class Scales:
    """Units of the errors of q (nv,) in tangent space and v (nv,), and the Huber delta in these units.

    They are the standard deviations of the logged one-step change, larger where sensor noise would rule; infinite ones
    leave a coordinate out. ``noise`` (2 nv,): standard deviations of the noise of q and v, or None for a log without
    noise, whose states are exact.
    """

    q: np.ndarray
    v: np.ndarray
    huber: float
    noise: np.ndarray | None = None

    @classmethod
    def of(cls, scene: Scene, data: Transitions, huber: float, noise: np.ndarray | None = None) -> Scales:
        """The scales of ``data``; ``huber`` is the normalised residual from which errors count linearly."""
        q, v = spread(scene.difference(data.q, data.q_next)), spread(data.v_next - data.v)
        if noise is None:
            return cls(q, v, huber)
        q, v = (np.hypot(s, n / _MODEL_SHARE) for s, n in zip((q, v), np.split(noise, 2), strict=True))
        return cls(q, v, huber, noise)

    @property
    def uncertain(self) -> np.ndarray:
        """Coordinates of a start (k,) that noise leaves open."""
        return np.flatnonzero(self.noise) if self.noise is not None else np.empty(0, dtype=int)

    @property
    def start_precision(self) -> np.ndarray:
        """Inverse standard deviations (k,) of the ``uncertain`` coordinates, in the units of the loss."""
        return np.empty(0) if self.noise is None else _MODEL_SHARE / self.noise[self.uncertain]

    @classmethod
    def of_positions(cls, data: Transitions, horizon: int, huber: float) -> Scales:
        """Of a log whose velocities are estimates: standard deviations of the change over ``horizon`` steps."""
        starts = data.windows(horizon)
        change = data.q_next[starts + horizon - 1] - data.q[starts]
        return cls(spread(change), np.full(data.v.shape[1], np.inf), huber)

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
    """From each row of ``starts`` (S,), ``horizon`` steps of ``data`` under the logged controls.

    ``offset`` (S, k): how far each start is from the logged state, along ``scales.uncertain``; None for not at all.
    """

    data: Transitions
    starts: np.ndarray
    horizon: int
    scales: Scales
    offset: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "starts", np.ascontiguousarray(self.starts, dtype=np.int64))

    @property
    def blocks(self) -> np.ndarray:
        """Block (S,) of each window; blocks are held out and resampled as a whole."""
        return blocks_of(self.data)[self.starts]

    def on(self, starts: np.ndarray) -> Windows:
        """The same windows from the logged states of other ``starts``."""
        return replace(self, starts=starts, offset=None)

    def begin(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        """The states that the windows start from: q (S, nq), v (S, nv)."""
        q, v = self.data.q[self.starts], self.data.v[self.starts]
        if self.offset is None:
            return q, v
        moved = np.zeros((len(q), 2 * scene.nv))
        moved[:, self.scales.uncertain] = self.offset
        return scene.integrate(q, moved[:, : scene.nv]), v + moved[:, scene.nv :]

    def states(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        """q (N, nq) and v (N, nv) of the log with the rows of the starts as in ``begin``."""
        if self.offset is None:
            return self.data.q, self.data.v
        q, v = self.data.q.copy(), self.data.v.copy()
        q[self.starts], v[self.starts] = self.begin(scene)
        return q, v


def blocks_of(data: Transitions) -> np.ndarray:
    """Parts (N,) of a log that hardly know of each other: its episodes, or consecutive parts of a single episode."""
    return data.episode if data.n_episodes > 1 else np.arange(len(data)) * BLOCKS // max(len(data), 1)


def spread(change: np.ndarray) -> np.ndarray:
    """Standard deviations of the columns of ``change``, away from zero."""
    spread = change.std(axis=0)
    return np.maximum(spread, max(_SCALE_FLOOR * spread.max(), 1e-9))
