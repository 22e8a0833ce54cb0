"""The log: transitions ``(q, v, u) -> (q_next, v_next)`` with their time step and episodes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cmbrl.data import checks, splitting, turns
from cmbrl.data.fields import ROWS, Fields
from cmbrl.data.remembered import remembered
from cmbrl.errors import UserError
from cmbrl.numbers import names, shown, whole

if TYPE_CHECKING:
    from cmbrl.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class Transitions:
    """N transitions of one robot. In row i, ``u[i]``, held for ``dt``, leads from ``(q[i], v[i])`` to the next state.

    The layout is MuJoCo's: for a free joint, ``q`` has the world position and a quaternion w x y z, ``v`` the world
    linear and *body* angular velocity; slides are in m, hinges in rad. Anything that numpy converts is accepted. The
    rows of an episode are contiguous and in time order. Construction checks shapes and values
    (:mod:`cmbrl.data.checks`) and raises :class:`cmbrl.UserError` that names the array and the row.
    """

    q: np.ndarray  #: (N, nq) configuration before the step [m, rad, unit quaternion]
    v: np.ndarray  #: (N, nv) velocity before the step [m/s, rad/s]
    u: np.ndarray  #: (N, nu) control applied during the whole step [unit of the actuator]
    q_next: np.ndarray  #: (N, nq) configuration after the step
    v_next: np.ndarray  #: (N, nv) velocity after the step
    dt: float  #: duration of one transition [s]
    episode: np.ndarray  #: (N,) int64, the episode of each row
    joint_names: tuple[str, ...] = ()  #: names in the order of ``q``; empty if unknown
    actuator_names: tuple[str, ...] = ()  #: names in the order of ``u``; empty if unknown
    source: dict[str, Any] = field(default_factory=dict)  #: origin of the log (task, behaviour, seed, versions)
    recording: np.ndarray = None  # type: ignore[assignment]  #: (N,) int64, which of several logs a row is from

    def __post_init__(self) -> None:
        for name, array in checks.stacked(self.q, self.v, self.u, self.q_next, self.v_next).items():
            object.__setattr__(self, name, array)
        object.__setattr__(self, "dt", checks.duration(self.dt))
        object.__setattr__(self, "episode", checks.episodes(self.episode, len(self.q)))
        recording = np.zeros(len(self.q)) if self.recording is None else self.recording
        object.__setattr__(self, "recording", checks.episodes(recording, len(self.q), "recording"))
        object.__setattr__(self, "joint_names", names(self.joint_names, "joint_names"))
        object.__setattr__(self, "actuator_names", names(self.actuator_names, "actuator_names"))
        if not isinstance(self.source, dict):
            raise UserError(f"source is a {type(self.source).__name__}; give a dict that says where the log is from")

    def __len__(self) -> int:
        return len(self.q)

    @property
    def n_episodes(self) -> int:
        """Number of episodes."""
        return len(np.unique(self.episode))

    def fields(self) -> Fields:
        """The constructor's arguments."""
        return cast(Fields, dict(vars(self)))

    def select(self, rows: Any) -> Transitions:
        """The rows of an index array, a boolean mask (N,) or a slice, in that order.

        Raises UserError if the order splits an episode.
        """
        chosen = splitting.row_numbers(rows, len(self))
        picked = {name: getattr(self, name)[chosen] for name in (*ROWS, "episode", "recording")}
        return replace(self, **picked)

    @staticmethod
    def joined(logs: Sequence[Transitions]) -> Transitions:
        """All rows of several logs of one robot, in order, as one log: episodes renumbered, the rest of the first.

        Raises UserError for logs of different shapes or time steps, and for no logs.
        """
        if not isinstance(logs, list | tuple) or not all(isinstance(log, Transitions) for log in logs):
            raise UserError(f"logs = {shown(logs)}: give a list of Transitions")
        return Transitions(**splitting.joined([log.fields() for log in logs]))

    def split(self, fraction: float, seed: int = 0) -> tuple[Transitions, Transitions]:
        """Two logs: a random ``fraction`` of the episodes (rounded, at least one), and the others.

        The same seed gives the same split; rows keep their order. Raises UserError for a single episode, or a fraction
        outside (0, 1).
        """
        first = splitting.episode_mask(self.episode, fraction, seed)
        return self.select(first), self.select(~first)

    def windows(self, k: int) -> np.ndarray:
        """Rows (int64) that start k consecutive transitions, each from the state in which the last one ended."""
        steps = whole(k, "k, the transitions of a window,")
        return remembered(self, ("windows", steps), lambda: splitting.window_starts(self.fields(), steps))

    def normalised(self, scene: Scene) -> Transitions:
        """The same log with quaternions of norm 1, for a log that passed ``check``."""
        q, q_next = (checks.unit_quaternions(x, scene) for x in (self.q, self.q_next))
        return replace(self, q=q, q_next=q_next)

    def going_on(self, scene: Scene) -> Transitions:
        """The same log with whole turns added to the angles that begin again after one (:mod:`cmbrl.data.turns`)."""
        q, q_next = self.q.copy(), self.q_next.copy()
        for v, hinge in turns.hinges(scene).items():
            k, change = hinge.qadr, 0.5 * self.dt * (self.v[:, v] + self.v_next[:, v])
            q[:, k], q_next[:, k] = turns.transitions_going_on(q[:, k], q_next[:, k], change, self.episode, hinge)
        return replace(self, q=q, q_next=q_next)

    def check(self, scene: Scene, dt: float | None = None) -> None:
        """Raises UserError unless this is a log of ``scene``'s robot, with time step ``dt`` [s] if given."""
        checks.against_scene(self.fields(), scene, None if dt is None else checks.duration(dt))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes ``NAME.npz``, a Minari folder (no suffix), or ``minari:ID`` in Minari's root; all or nothing."""
        from cmbrl.data import files

        files.save(self.fields(), path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Transitions:
        """Reads what :meth:`save` writes, other Minari datasets with raw states, and npz files of trajectories.

        Raises UserError that names the file if it is missing, of another kind, empty or damaged.
        """
        from cmbrl.data import files

        fields = files.load(path)
        try:
            log = Transitions(**fields)
        except UserError as error:
            raise UserError(f"{path}: {error}") from None
        if len(log) == 0:
            raise UserError(f"{path}: the log is empty; record at least one transition")
        return log
