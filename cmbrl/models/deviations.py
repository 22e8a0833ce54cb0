"""Standard deviations of what a log holds: the units in which errors are shown to the user."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

_STILL = 1e-9  # a coordinate with a smaller standard deviation [m, rad, m/s, rad/s] is constant
_MEAN_ITERATIONS = 10  # on the manifold: exact at once for translations, iterative for rotations


def deviations(data: Transitions, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (2 nv,) of the change over a row, and of the state about its mean; NaN if zero."""
    change = np.hstack([scene.difference(data.q, data.q_next), data.v_next - data.v]).std(axis=0)
    mean = data.q[0]
    for _ in range(_MEAN_ITERATIONS):
        offset = scene.difference(np.broadcast_to(mean, data.q.shape), data.q)
        mean = scene.integrate(mean, offset.mean(axis=0))
    state = np.hstack([offset.std(axis=0), data.v.std(axis=0)])
    return np.where(change < _STILL, np.nan, change), np.where(state < _STILL, np.nan, state)
