"""Stacks trajectories into transitions between neighbouring rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np

from cmbrl.data import checks
from cmbrl.data.fields import Fields
from cmbrl.errors import UserError
from cmbrl.numbers import real_array

Difference = Callable[[np.ndarray, np.ndarray], np.ndarray]


def stack(
    q: Any, lengths: Any, dt: Any, v: Any = None, u: Any = None, difference: Difference | None = None, **about: Any
) -> Fields:
    """The transitions of :func:`cmbrl.data.trajectories.read_trajectories`, with the same arguments and errors."""
    q, dt = checks.numbers("q", q), checks.duration(dt)
    size = real_array(lengths, "lengths")
    if size.ndim != 1 or not (size >= 1).all() or (size != np.floor(size)).any() or size.sum() != len(q):
        raise UserError(
            f"q has shape {q.shape} and lengths sum to {size.sum():g}; give q as (rows, nq) and lengths as whole "
            "numbers that sum to the number of rows"
        )
    size = size.astype(np.int64)
    episode = np.repeat(np.arange(len(size)), size)
    same = episode[1:] == episode[:-1]
    usable = np.ones(len(q), dtype=bool)
    if v is None:
        v, usable = _backward_difference(q, same, dt, difference)
    v = checks.numbers("v", v)
    u = np.zeros((len(q), 0)) if u is None else checks.numbers("u", u)
    for name, array in (("v", v), ("u", u)):
        if len(array) != len(q):
            raise UserError(f"{name} has shape {array.shape}; give one row for each of the {len(q)} rows of q")
    now = np.flatnonzero(same & usable[:-1])
    if len(now) == 0:
        raise UserError("every trajectory is too short; a transition takes 2 rows, or 3 without velocities")
    rows = Fields(q=q[now], v=v[now], u=u[now], q_next=q[now + 1], v_next=v[now + 1], dt=dt, episode=episode[now])
    return cast(Fields, {**rows, **about})


def _backward_difference(
    q: np.ndarray, same: np.ndarray, dt: float, difference: Difference | None
) -> tuple[np.ndarray, np.ndarray]:
    """Velocities (M, nv), and the mask (M,) of rows that have one: all but the first of each trajectory."""
    step = q[1:] - q[:-1] if difference is None else difference(q[:-1], q[1:])
    has = np.concatenate([[False], same])
    return np.concatenate([np.zeros((1, step.shape[1])), step / dt]), has
