"""Windows of a log: what a model predicts open loop, and the scales that its errors are measured in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.remembered import remembered
from cmbrl.errors import UserError
from cmbrl.models.deviations import REST

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

BLOCKS = 8  #: parts of a log of a single episode
_MODEL_SHARE = 0.25  # of the change: about what a contact model leaves; sensor noise is weighed against it
_NOISE_SHARE = 0.02  # of a unit of positions: about what a model of a robot leaves, too
_START_SHARE = 0.01  # the same of a model whose starts are free, against which they are weighed
_FINEST = 0.01  # of the change: what a model leaves of a coordinate is taken for so much at least
_DIFFERENCES = (-1.0, 5.0, -10.0, 10.0, -5.0, 1.0)  # of changes: sixth ones of positions
_OF_NORMAL, _LEAST_TOLD = 0.6745, 20  # median of a normal's absolute values; rows that tell noise
_SCALE_FLOOR = 1e-3  # of the largest scale of its kind, so that a coordinate that hardly moves does not dominate


@dataclass(frozen=True)
class Scales:
    """Units of the errors of q (nv,) in tangent space and v (nv,), and the Huber delta in these units.

    They are the standard deviations of the logged one-step change, larger where sensor noise would rule; infinite ones
    leave a coordinate out. ``noise`` (2 nv,): standard deviations of the noise of q and v, or None for a log without
    noise, whose states are exact. ``left``: about what a model leaves, in these units; noise is weighed against it.
    """

    q: np.ndarray
    v: np.ndarray
    huber: float
    noise: np.ndarray | None = None
    left: float = _MODEL_SHARE

    @classmethod
    def of(cls, scene: Scene, data: Transitions, huber: float, noise: np.ndarray | None = None) -> Scales:
        """The scales of ``data``; ``huber`` is the normalised residual from which errors count linearly."""
        q = spread(scene.difference(data.q, data.q_next), REST * data.dt)
        v = spread(data.v_next - data.v, REST)
        return cls(q, v, huber) if noise is None else cls(q, v, huber).noisy(noise)

    def noisy(self, noise: np.ndarray) -> Scales:
        """The scales of such a log with sensor ``noise`` (2 nv,)."""
        q, v = (np.hypot(s, n / self.left) for s, n in zip((self.q, self.v), np.split(noise, 2), strict=True))
        return replace(self, q=q, v=v, noise=noise)

    @property
    def uncertain(self) -> np.ndarray:
        """Coordinates of a start (k,) that noise leaves open."""
        return np.flatnonzero(self.noise) if self.noise is not None else np.empty(0, dtype=int)

    @property
    def start_precision(self) -> np.ndarray:
        """Inverse standard deviations (k,) of the ``uncertain`` coordinates, in the units of the loss."""
        return np.empty(0) if self.noise is None else self.left / self.noise[self.uncertain]

    @classmethod
    def of_positions(
        cls, scene: Scene, data: Transitions, horizon: int, huber: float, noise: np.ndarray | None = None,
        left: np.ndarray | None = None,
    ) -> Scales:  # fmt: skip
        """Of a log whose velocities are estimates: standard deviations of the change over ``horizon`` steps.

        They are so large that the noise of what rests, or hardly moves, does not hide the errors of all that moves.
        ``noise`` (2 nv,): of what starts of predictions may be off by. ``left`` (nv,): share of the change that a model
        leaves of each coordinate; of which it leaves less than usual, the units are smaller, so that all weigh as much.
        """

        def change() -> np.ndarray:
            starts = data.windows(horizon)
            return spread(scene.difference(data.q[starts], data.q_next[starts + horizon - 1]))

        usual = remembered(data, ("change", scene, horizon), change)
        finer = 1.0 if left is None else np.clip(left / _NOISE_SHARE, _FINEST, 1.0)
        units = np.hypot(usual * finer, least_units(scene, data))
        return cls(units, np.full(data.v.shape[1], np.inf), huber, noise, _START_SHARE)

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

    ``offset`` (S, k): how far each start is from the logged state, along ``scales.uncertain``; None for not at all,
    (C, S, k) where each of C candidates has its own.
    ``own``: the scales of each of several logs, if they differ; all have the same ``uncertain`` and ``counts``.
    ``level``: the loss from which on only the logarithm of a window's loss counts (Cauchy's).
    Raises UserError for a window that leaves the log.
    """

    data: Transitions
    starts: np.ndarray
    horizon: int
    scales: Scales
    offset: np.ndarray | None = None
    own: tuple[Scales, ...] = ()
    level: float = np.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "starts", np.ascontiguousarray(self.starts, dtype=np.int64))
        outside = (self.starts < 0) | (self.starts > len(self.data) - self.horizon)
        if outside.any():
            start = int(self.starts[outside][0])
            rows = f"{len(self.data)} rows: choose another"
            raise UserError(f"start {start} with a horizon of {self.horizon} leaves the log of {rows}")

    @cached_property
    def rows(self) -> np.ndarray:
        """Rows (R,) of the log that the windows cover, ascending."""
        return np.unique(self.starts[:, None] + np.arange(self.horizon))

    @property
    def blocks(self) -> np.ndarray:
        """Block (S,) of each window; blocks are held out and resampled as a whole."""
        return blocks_of(self.data)[self.starts]

    @property
    def recording(self) -> np.ndarray:
        """Log (S,) of each window."""
        return self.data.recording[self.starts]

    @property
    def units(self) -> np.ndarray:
        """What errors of q and v are measured in: (S, 2 nv), or (1, 2 nv) where all windows are alike."""
        units = np.stack([np.concatenate([scales.q, scales.v]) for scales in self.own or (self.scales,)])
        return units[self.recording] if self.own else units

    @property
    def start_precision(self) -> np.ndarray:
        """Inverse standard deviations (S, k) or (1, k) of the starts along ``scales.uncertain``."""
        precision = np.stack([scales.start_precision for scales in self.own or (self.scales,)])
        return precision[self.recording] if self.own else precision

    @property
    def price(self) -> np.ndarray:
        """What windows pay for their ``offset``, by step: (S,), (C, S) as there, or (1,) without one."""
        if self.offset is None:
            return np.zeros(1)
        return huber(self.offset * self.start_precision, self.scales.huber).sum(axis=-1) / self.horizon

    def counted(self, losses: np.ndarray) -> np.ndarray:
        """What ``losses`` (..., S) of windows count: ``level`` log(1 + loss / level)."""
        return self.level * np.log1p(losses / self.level) if self.level < np.inf else losses

    def weight(self, losses: np.ndarray) -> np.ndarray:
        """The derivative (..., S) of ``counted``."""
        return 1.0 / (1.0 + losses / self.level)

    def by_scales(self) -> list[tuple[np.ndarray, Windows]]:
        """The windows apart by their scales, so that each part has common ones, with a mask (S,) of which they are."""
        if not self.own:
            return [(np.ones(len(self.starts), dtype=bool), self)]
        chosen = [(scales, self.recording == k) for k, scales in enumerate(self.own)]
        return [(rows, replace(self.some(rows), scales=scales, own=())) for scales, rows in chosen if rows.any()]

    def some(self, rows: np.ndarray | slice) -> Windows:
        """Those windows in ``rows``: a mask (S,), numbers, or a slice."""
        offset = None if self.offset is None else self.offset[..., rows, :]
        return replace(self, starts=self.starts[rows], offset=offset)

    def on(self, starts: np.ndarray) -> Windows:
        """The same windows from the logged states of other ``starts``."""
        return replace(self, starts=starts, offset=None)

    def on_rows(self, data: Transitions) -> Windows:
        """The same windows where ``data`` are the ``rows`` of the log alone."""
        return replace(self, data=data, starts=np.searchsorted(self.rows, self.starts))

    def begin(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        """The states that the windows start from: q (S, nq), v (S, nv); (C, S, ...) where candidates have their own."""
        q, v = self.data.q[self.starts], self.data.v[self.starts]
        if self.offset is None:
            return q, v
        moved = np.zeros((*self.offset.shape[:-1], 2 * scene.nv))
        moved[..., self.scales.uncertain] = self.offset
        return scene.integrate(q, moved[..., : scene.nv]), v + moved[..., scene.nv :]


def huber(residual: np.ndarray, delta: float) -> np.ndarray:
    """rho(r), elementwise: r^2 / 2 up to ``delta``, then as its tangent there."""
    size = np.abs(residual)
    return np.where(size <= delta, 0.5 * residual**2, delta * (size - 0.5 * delta))


def blocks_of(data: Transitions) -> np.ndarray:
    """Parts (N,) of a log that hardly know of each other: its episodes, or consecutive parts of a single episode.

    Each of several logs is divided by itself.
    """
    return remembered(data, "blocks", lambda: _blocks_of(data))


def _blocks_of(data: Transitions) -> np.ndarray:
    blocks, known = np.zeros(len(data), dtype=np.int64), 0
    for k in np.unique(data.recording):
        rows = np.flatnonzero(data.recording == k)
        episodes, part = np.unique(data.episode[rows], return_inverse=True)
        part = part if len(episodes) > 1 else np.arange(len(rows)) * BLOCKS // len(rows)
        blocks[rows], known = known + part, known + int(part.max()) + 1
    return blocks


def spread(change: np.ndarray, least: float = 1e-9) -> np.ndarray:
    """Standard deviations of the columns of ``change``, ``least`` at least.

    What rests, such as an object that a gripper has not touched yet, moves in simulation by what its solver leaves: in
    that unit every error is large, and a fit would be of nothing else.
    """
    spread = change.std(axis=0)
    return np.maximum(spread, max(_SCALE_FLOOR * spread.max(), least))


def least_units(scene: Scene, data: Transitions) -> np.ndarray:
    """Units (nv,) of errors of positions in which their noise is small."""
    return noise_of_positions(scene, data) / _NOISE_SHARE


def noise_of_positions(scene: Scene, data: Transitions) -> np.ndarray:
    """Standard deviations (nv,) of the noise of positions; 0 where the log is too short to tell.

    Sixth differences tell noise: they are hardly any of what moves, and the median does not look at impacts.
    """
    return remembered(data, ("noise of positions", scene), lambda: _noise_of_positions(scene, data))


def _noise_of_positions(scene: Scene, data: Transitions) -> np.ndarray:
    order = len(_DIFFERENCES)
    rows = data.windows(order)
    if len(rows) < _LEAST_TOLD:
        return np.zeros(data.v.shape[1])
    change = scene.difference(data.q, data.q_next)
    sixth = sum(weight * change[rows + k] for k, weight in enumerate(_DIFFERENCES))
    return np.asarray(np.median(np.abs(sixth), axis=0) / _OF_NORMAL / np.sqrt(comb(2 * order, order)))


def thinned(rows: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of ``rows`` (N,), evenly spread."""
    return rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).astype(np.int64)]
