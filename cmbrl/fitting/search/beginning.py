"""Where a fit begins: at the file or, where its links chatter, with some rotor and damping at their joints.

Many files, all URDFs among them, have neither armature nor damping. A stiff servo may then shake a light link in
simulation as it shakes no robot. Such motion is chaos, and derivatives along it lead nowhere. So levels of both are
tried, alike at all joints that the file gives none, and a fit begins at the best one if that explains the log clearly
better than the file does.
"""

from __future__ import annotations

from contextlib import suppress
from itertools import product

import numpy as np

from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal, OutOfTime

_GROUPS = ("armature", "damping")
_LEVELS = (0.0, 0.1, 0.3, 1.0)  # prior standard deviations
_CLEARLY = 0.9  # times the file's loss


def beginning(loss: PredictionLoss, space: Space, movable: np.ndarray, journal: Journal) -> np.ndarray:
    """Where (n,) in z a fit begins that may move ``movable`` (n,); zeros: the file, if nothing is clearly better.

    When the time of the ``journal`` is up, the best one so far.
    """
    directions = begins(space, movable)
    if not directions.any():
        return np.zeros(len(space))
    points = np.array([np.dot(levels, directions) for levels in product(_LEVELS, repeat=len(_GROUPS))])
    points = np.clip(points, space.z_low, space.z_high)  # the first is the file
    losses = np.full(len(points), np.inf)
    with suppress(OutOfTime):
        for some in np.array_split(np.arange(len(points)), len(_LEVELS)):
            journal.check_time()
            losses[some] = np.nan_to_num(loss.values(space.theta(points[some])), nan=np.inf)
    best = int(losses.argmin())
    return points[best] if losses[best] < _CLEARLY * losses[0] else points[0]


def begins(space: Space, movable: np.ndarray) -> np.ndarray:
    """Mask (2, n) of the ``movable`` armatures and dampings that the file does not give."""
    groups, absent = np.array(space.groups), movable & (space.nominal == 0.0)
    return np.array([absent & (groups == group) for group in _GROUPS])
