"""The log: stacked transitions ``(q, v, u) -> (q_next, v_next)`` with their time step and episode."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.data import checks, splitting

if TYPE_CHECKING:
    from cmbrl.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class Transitions:
    """N transitions of one robot; row i: ``u[i]``, held for ``dt``, led from ``(q[i], v[i])`` to the next state.

    The layout is MuJoCo's: a free joint is world position and quaternion w x y z in ``q``, world linear and *body*
    angular velocity in ``v``; slides in m, hinges in rad. Anything that numpy can convert (CPU tensors too) is taken.
    Rows of one episode are contiguous and in time order. Construction checks shapes and values (see
    :mod:`cmbrl.data.checks`) and raises :class:`cmbrl.UserError` that names the array and the row.
    """

    q: np.ndarray  #: (N, nq) configuration before the step [m, rad, unit quaternion]
    v: np.ndarray  #: (N, nv) velocity before the step [m/s, rad/s]
    u: np.ndarray  #: (N, nu) control applied during the whole step [unit of the actuator]
    q_next: np.ndarray  #: (N, nq) configuration after the step
    v_next: np.ndarray  #: (N, nv) velocity after the step
    dt: float  #: duration of one transition [s]
    episode: np.ndarray  #: (N,) int64, the episode that a row belongs to
    joint_names: tuple[str, ...] = ()  #: names in the order of ``q``; empty when the source does not tell
    actuator_names: tuple[str, ...] = ()  #: names in the order of ``u``; empty when the source does not tell
    source: dict[str, Any] = field(default_factory=dict)  #: where the log comes from (task, behaviour, seed, versions)

    def __post_init__(self) -> None:
        for name, array in checks.stacked(self.q, self.v, self.u, self.q_next, self.v_next).items():
            object.__setattr__(self, name, array)
        object.__setattr__(self, "dt", checks.duration(self.dt))
        object.__setattr__(self, "episode", checks.episodes(self.episode, len(self.q)))
        object.__setattr__(self, "joint_names", tuple(map(str, self.joint_names)))
        object.__setattr__(self, "actuator_names", tuple(map(str, self.actuator_names)))

    def __len__(self) -> int:
        return len(self.q)

    @property
    def n_episodes(self) -> int:
        """Number of episodes."""
        return len(np.unique(self.episode))

    def select(self, rows: Any) -> Transitions:
        """The rows that an index array, a boolean mask (N,) or a slice picks, in the order given.

        Raises UserError when the order given tears an episode apart.
        """
        picked = {name: getattr(self, name)[rows] for name in ("q", "v", "u", "q_next", "v_next", "episode")}
        return replace(self, **picked)

    @staticmethod
    def joined(logs: Sequence[Transitions]) -> Transitions:
        """All rows of logs of one robot, in order, no two with an episode in common; names and source of the first.

        Raises UserError on logs of different shapes or time steps, and on none.
        """
        return splitting.joined(logs)

    def split(self, fraction: float, seed: int = 0) -> tuple[Transitions, Transitions]:
        """Two logs without a common episode: ``fraction`` of the episodes (rounded, at least one), and the others.

        The same seed gives the same split; rows keep their order. Raises UserError on a single episode and on a
        fraction outside (0, 1).
        """
        first = splitting.episode_mask(self.episode, fraction, seed)
        return self.select(first), self.select(~first)

    def windows(self, k: int) -> np.ndarray:
        """Rows (int64) that start k consecutive transitions, each beginning in the state in which the former ended."""
        return splitting.window_starts(self, k)

    def check(self, scene: Scene, dt: float | None = None) -> None:
        """Raises UserError unless this is a log of ``scene``'s robot (and of time step ``dt`` [s], when given)."""
        checks.against_scene(self, scene, dt)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes ``NAME.npz``, a Minari folder (no suffix) or ``minari:ID`` in Minari's root, whole or not at all."""
        from cmbrl.data import files

        files.save(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Transitions:
        """Reads what :meth:`save` writes, other Minari datasets with raw states, and npz files of trajectories.

        Raises UserError that names the file when it is missing, of another kind, empty or damaged.
        """
        from cmbrl.data import files

        return files.load(path)
