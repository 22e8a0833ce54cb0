"""Integral action of position servos: what target and encoder have been apart so far goes on pulling.

Such a servo, as most PID controllers of positions are, holds a load without being off. Its control is the target and

    r s,    s' = target - reading,

r being the gain of the integral over that of the position. A log tells targets and readings, so it tells s. A
prediction that starts from the log has the s of its start, and goes on by what it is apart from the target itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from cmbrl.data.remembered import remembered

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions


def ends_of(log: Transitions, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last rows (R,) of the episodes of ``rows`` (R,)."""
    begins = remembered(
        log, "begins", lambda: np.append(np.flatnonzero(np.r_[True, np.diff(log.episode) != 0]), len(log))
    )
    block = np.searchsorted(begins, rows, side="right") - 1
    return begins[block], begins[block + 1] - 1


class Lacked:
    """What targets and readings of a log have been apart, with s = 0 in the mean of each episode.

    So what is to be added to s is what a servo needs in the mean: that hardly depends on how an episode began.

    ``reading`` (nu, n): the control that a unit of each of the positions ``joints`` (n,) takes the place of, negative.
    """

    def __init__(self, log: Transitions, joints: np.ndarray, reading: np.ndarray) -> None:
        self.dt, self.u = log.dt, log.u
        self.first, self.last = ends_of(log, np.arange(len(log)))
        self.given = self._sum(log.u)
        before, after = (q[:, joints] @ reading.T for q in (log.q, log.q_next))
        self.read = self._sum(0.5 * (before + after)) + 0.5 * log.dt * before  # to the middle of the step, by its start
        self.read -= self._mean(self.given + self.read)

    def _sum(self, x: np.ndarray) -> np.ndarray:
        """Of ``x`` (N, nu), the integral from the start of the episode to the start of each row."""
        total = self.dt * (np.cumsum(x, axis=0) - x)
        return np.asarray(total - total[self.first])

    def _mean(self, x: np.ndarray) -> np.ndarray:
        """Of ``x`` (N, nu), the mean of its episode in each row."""
        total = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)])
        count = self.last + 1 - self.first
        return np.asarray((total[self.last + 1] - total[self.first]) / count[:, None])

    def targets(self, rows: np.ndarray, back: int) -> np.ndarray:
        """The integral (R, nu) of commands ``back`` steps late, to the middle of the step of each of ``rows``.

        Beyond an episode its first and last commands were and are held.
        """
        now, begun = self._until(rows - back, rows), self._until(self.first[rows] - back, rows)
        return now + 0.5 * self.dt * self.u[np.clip(rows - back, self.first[rows], self.last[rows])] - begun

    def _until(self, at: np.ndarray, rows: np.ndarray) -> np.ndarray:
        inside = np.clip(at, self.first[rows], self.last[rows])
        return np.asarray(self.given[inside] + self.dt * (at - inside)[:, None] * self.u[inside])


class OwnIntegral:
    """Controls of a log, corrected step by step for where a prediction from it has gone other ways.

    ``gains`` (nu, nq) [1/s]: how controls change with the integral of positions; None for not at all.
    """

    def __init__(self, gains: Any, dt: float) -> None:
        self.gains, self.dt = gains, dt
        self.apart: Any = None  #: (B, nq): what the positions of prediction and log have been apart

    def __call__(self, u: Any, q: Any, told: Any) -> Any:
        """The control (B, nu) for ``u`` of the log where the prediction is at ``q`` (B, nq), and the log ``told``."""
        if self.gains is None:
            return u
        off = self.dt * (q - told)
        self.apart = 0.5 * off if self.apart is None else self.apart + off  # to the middle of the step
        return u + self.apart @ self.gains.T


def own_integral(model: Any) -> OwnIntegral:
    """That of a model whose servos may integrate."""
    gains = getattr(model, "integral", None)
    return OwnIntegral(None if gains is None else torch.from_numpy(gains), model.dt)
