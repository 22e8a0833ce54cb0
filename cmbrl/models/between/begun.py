"""What servos that integrate add to their targets in each episode of a log, as a model and the log tell it.

What a servo had integrated when an episode began is part of the state that no log has. It stays in the control for the
whole episode, as a constant:

    x = argmin sum_k |v_(k+1) - v'(q_k, v_k, u_k + C x)|^2_W + |x|^2 / s^2,

over the first rows k of the episode, in steps of Gauss-Newton. v' is the velocity that the model predicts, C what a
unit of x does to the control, W the inverse variances of the errors. Errors of velocities cancel from row to row, so
seconds tell x far better than one row does. Where dry friction holds a joint, nothing tells its x.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.models.between.integral import ends_of
from cmbrl.models.between.parameters import INTEGRAL, INTEGRATED

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.models.between.log_reading import LogReading
    from cmbrl.models.between.observation import Observation

_SPREAD = 0.3  # [rad] or [m], of a target: s
_ITERATIONS = 2  # friction makes it not quite linear
_ROWS, _LEAST = 4_000, 200  # of all episodes together, and of each at least where it has so many: they tell enough
_ROWS_AT_ONCE = 2_000  # whose Jacobian is in memory


@dataclass(frozen=True, eq=False)
class Begun:
    """``control`` (E, nu): what is added to the commands of each of the ``episodes`` (E,), which ascend."""

    episodes: np.ndarray
    control: np.ndarray

    def of(self, episode: np.ndarray) -> np.ndarray:
        """What it adds (R, nu) in rows of each ``episode`` (R,); nothing in episodes of another log."""
        place = np.clip(np.searchsorted(self.episodes, episode), 0, len(self.episodes) - 1)
        known = self.episodes[place] == episode
        return np.where(known[:, None], self.control[place], 0.0)


def begun(
    observation: Observation, model: LogReading, log: Transitions, theta: np.ndarray, least: int = 1
) -> Observation:
    """``observation`` with what servos add in each episode of ``log``, by ``model`` at ``theta`` (np + n,).

    The same object where none integrates, or there are fewer than ``least`` episodes.
    """
    physical, psi = observation.split(theta)
    if not psi[observation.place[INTEGRAL]].any() or (least > 1 and len(np.unique(log.episode)) < least):
        return observation
    state = replace(observation, begun=None).states(log, psi)
    return replace(
        observation, begun=_told(model, log, state, physical, observation.servo[:, observation.place[INTEGRATED]])
    )


def _told(model: LogReading, log: Transitions, state: Transitions, theta: np.ndarray, adds: np.ndarray) -> Begun:
    """What is added in each episode of a ``log``, which the model of parameters ``theta`` (np,) sees as ``state``.

    ``adds`` (nu, n): what a unit of each joint's integral does to the controls.
    """
    episodes, where = np.unique(log.episode, return_inverse=True)
    every = np.arange(len(log))
    rows = every[every - ends_of(log, every)[0] < max(_ROWS // len(episodes), _LEAST)]
    state, where = state.select(rows), where[rows]
    found = np.zeros((len(episodes), adds.shape[1]))
    for _ in range(_ITERATIONS):
        u = state.u.copy()
        u[:, : len(adds)] += found[where] @ adds.T
        error, slope = _errors(model, state, u, theta, adds)
        weight = 1.0 / np.maximum(np.square(error).mean(axis=0), 1e-300)
        for k in range(len(episodes)):
            own = where == k
            weighted = slope[own] * weight[:, None]
            told = np.einsum("rvi,rvj->ij", weighted, slope[own]) + np.eye(adds.shape[1]) / _SPREAD**2
            pull = np.einsum("rvi,rv->i", weighted, error[own]) - found[k] / _SPREAD**2
            found[k] += np.linalg.solve(told, pull)
    return Begun(episodes, found @ adds.T)


def _errors(
    model: LogReading, state: Transitions, u: np.ndarray, theta: np.ndarray, adds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """By how much the velocities of the log exceed the predicted ones (R, nv), and the slopes of these (R, nv, n)."""
    nv, nu = state.v.shape[1], len(adds)
    error, slope = np.zeros_like(state.v), np.zeros((len(u), nv, adds.shape[1]))
    for begin in range(0, len(u), _ROWS_AT_ONCE):
        rows = slice(begin, begin + _ROWS_AT_ONCE)
        step = model.predict(state.q[rows], state.v[rows], u[rows], theta=theta, jacobian=True)
        assert step.jacobian is not None
        error[rows] = state.v_next[rows] - step.v_next
        slope[rows] = step.jacobian[:, nv:, 2 * nv : 2 * nv + nu] @ adds
    lost = ~(np.isfinite(error).all(axis=1) & np.isfinite(slope).all(axis=(1, 2)))
    error[lost], slope[lost] = 0.0, 0.0
    return error, slope
