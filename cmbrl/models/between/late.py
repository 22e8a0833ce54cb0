"""How commands that come late, and through a first-order lag, act in a step, as a smooth function of delay and lag."""

from __future__ import annotations

import numpy as np

NEXT = 2  #: commands that follow a step and may act in it
_TAIL = 20.0  # time constants after which a lag has settled, to 2e-9


def late_response(delay: float, lag: float, dt: float) -> np.ndarray:
    """``response``, where a delay below 0 makes the lag shorter first: the two together tell no more of a command.

    A log that is early and slow at once would be explained by many pairs of them, and no robot acts so.
    """
    if delay >= 0.0:
        return response(delay, lag, dt)
    both = delay + lag
    found, own = (response(0.0, both, dt), 2) if both > 0.0 else (response(both, 0.0, dt), 1)
    return found[[0, own, own]]


def response(delay: float, lag: float, dt: float) -> np.ndarray:
    """Weights (3, 2 + taps) of commands in the mean of a step, from the next but one backwards, and their derivatives.

    These are in delay and lag. What follows the step counts under a delay below 0, of at least ``-2 dt``.
    """
    taps = max(0, int(np.ceil((delay + _TAIL * lag) / dt))) + 2
    late = np.maximum(np.arange(-NEXT, taps + 1) * dt - delay, 0.0)
    after = late > 0.0
    left = np.exp(-late / lag) if lag > 0.0 else np.where(after, 0.0, 1.0)
    tail = late / lag * left if lag > 0.0 else np.zeros_like(late)
    # The integral of the response 1 - exp(-(t - delay) / lag) of a step, and its derivatives.
    integral = np.stack([late - lag * (1.0 - left), -(1.0 - left), -(1.0 - left) + tail])
    mean = np.diff(integral, axis=1) / dt
    return np.diff(mean, axis=1, prepend=0.0)
