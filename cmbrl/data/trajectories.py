"""Transitions from trajectories: states row after row, with or without velocities and control."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.data import checks
from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions

Difference = Callable[[np.ndarray, np.ndarray], np.ndarray]


def read_trajectories(
    q: Any,
    lengths: Any,
    dt: Any,
    v: Any = None,
    u: Any = None,
    difference: Difference | None = None,
    **about: Any,
) -> Transitions:
    """Transitions between neighbouring rows of each trajectory; one trajectory is one episode.

    Args:
        q: (M, nq) configurations, the trajectories one after another.
        lengths: (E,) rows of each trajectory, summing to M.
        dt: time between two rows [s].
        v: (M, nv) velocities. When missing they are backward differences, ``v[k+1] = (q[k+1] - q[k]) / dt``, which is
            what a semi-implicit step with ``q' = q + dt v'`` reads; the first row of a trajectory then only serves
            to give the second one its velocity.
        u: (M, nu) control, row k applied from k to k+1; none by default (nu = 0).
        difference: ``scene.difference``, the tangent vector (nv) from one configuration to another; needed to find
            velocities where q holds quaternions. By default the plain difference.
        about: ``joint_names``, ``actuator_names``, ``source`` of :class:`~cmbrl.data.transitions.Transitions`.

    Raises UserError on NaN (naming its row), when lengths and rows disagree, and when no trajectory has enough rows.
    """
    from cmbrl.data.transitions import Transitions

    q, dt = checks.numbers("q", q), checks.duration(dt)
    size = np.asarray(lengths)
    if size.ndim != 1 or size.dtype.kind not in "iu" or (size < 1).any() or size.sum() != len(q):
        raise UserError(
            f"trajectories of shape {q.shape} with lengths summing to {size.sum() if size.size else 0}: give q as "
            "(rows, nq) and lengths as whole numbers that sum to the number of rows"
        )
    episode = np.repeat(np.arange(len(size)), size)
    same = episode[1:] == episode[:-1]
    usable = np.ones(len(q), dtype=bool)
    if v is None:
        v, usable = _backward_difference(q, same, dt, difference)
    v = checks.numbers("v", v)
    u = np.zeros((len(q), 0)) if u is None else checks.numbers("u", u)
    for name, array in (("v", v), ("u", u)):
        if len(array) != len(q):
            raise UserError(f"{name} has shape {array.shape}: give one row for each of the {len(q)} rows of q")
    now = np.flatnonzero(same & usable[:-1])
    if len(now) == 0:
        raise UserError("no trajectory has enough rows for a transition: at least 2 are needed, 3 without velocities")
    return Transitions(
        q=q[now], v=v[now], u=u[now], q_next=q[now + 1], v_next=v[now + 1], dt=dt, episode=episode[now], **about
    )


def _backward_difference(
    q: np.ndarray, same: np.ndarray, dt: float, difference: Difference | None
) -> tuple[np.ndarray, np.ndarray]:
    """Velocities (M, nv) and the mask (M,) of the rows that have one (all but the first of each trajectory)."""
    step = q[1:] - q[:-1] if difference is None else difference(q[:-1], q[1:])
    has = np.concatenate([[False], same])
    return np.concatenate([np.zeros((1, step.shape[1])), step / dt]), has
