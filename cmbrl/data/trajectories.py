"""Transitions from trajectories: states row by row, with or without velocities and controls."""

from __future__ import annotations

from typing import Any

from cmbrl.data.stacking import Difference, stack
from cmbrl.data.transitions import Transitions


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
        v: (M, nv) velocities. Default: backward differences, ``v[k+1] = (q[k+1] - q[k]) / dt``, which match a
            semi-implicit step ``q' = q + dt v'``; of a robot, and of shorter steps, they are half a row late, and a log
            of positions tells more. The first row of a trajectory then only serves the second.
        u: (M, nu) controls, row k applied from k to k+1. Default: none (nu = 0).
        difference: ``scene.difference``, the tangent vector (nv) from one configuration to another, to find velocities
            if q contains quaternions. Default: the plain difference.
        about: ``joint_names``, ``actuator_names``, ``source`` of :class:`~cmbrl.data.transitions.Transitions`.

    Raises:
        UserError: for NaN (naming its row), if lengths and rows disagree, or if every trajectory is too short.
    """
    return Transitions(**stack(q, lengths, dt, v, u, difference, **about))
