"""Standard deviations of what a log holds: the units in which errors are shown to the user."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

_STILL = 1e-9  # a coordinate with a smaller standard deviation [m, rad, m/s, rad/s] is constant,
_ROUNDED = 1e-6  # and so is one with this share of the largest: a solver's tolerance moves it, or rounding
REST = 1e-4  #: [m/s, rad/s], and of places [m, rad]: what moves less rests, and errors are in this unit at least
_MEAN_ITERATIONS = 10  # on the manifold: exact at once for translations, iterative for rotations


def deviations(data: Transitions, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (2 nv,) of the change over a row, and of the state about its mean; NaN if constant."""
    change = np.hstack([scene.difference(data.q, data.q_next), data.v_next - data.v]).std(axis=0)
    mean = data.q[0]
    for _ in range(_MEAN_ITERATIONS):
        offset = scene.difference(np.broadcast_to(mean, data.q.shape), data.q)
        mean = scene.integrate(mean, offset.mean(axis=0))
    state = np.hstack([offset.std(axis=0), data.v.std(axis=0)])
    return _moving(change, REST * data.dt), _moving(state, REST)


def _moving(found: np.ndarray, rest: float) -> np.ndarray:
    """``found`` (2 nv,), but for constant coordinates, which are NaN; positions are ``rest`` at least.

    Velocities are measured against velocities.
    """
    halves = found.reshape(2, -1)
    least = np.maximum(_STILL, _ROUNDED * halves.max(axis=1, keepdims=True))
    return np.where(halves < least, np.nan, np.maximum(halves, [[rest], [REST]])).ravel()
