"""Whether leads are those of a controller that damps what the velocity lacks of the target's.

Such a controller leads by kd / kp in all its servos alike. Leads that do not are numbers that make up for something
else: they follow the motions of the log, and fail in faster ones.
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.models.between.parameters import LEAD

_SHARE = 0.75, 1.4  # of kd / kp, in the median over servos; joints' own damping takes a part of it
BEGUN = 0.55  #: at least the same of a short fit, which begins with too little damping: that made up for leads


def as_controlled(loss: PredictionLoss, theta: np.ndarray, least: float = _SHARE[0]) -> bool:
    """Whether leads at ``theta`` (n,) are about kd / kp, in the median of the servos that damp anything."""
    scene, observer = loss.model.scene, loss.observation
    physical, psi = observer.split(theta)
    P, layout = scene.physical_vector(physical), scene.layout
    own = np.array([p.group == LEAD for p in observer.parameters])
    stiff, drag = (
        np.array([-P[layout.actuator(int(k), field)] for k in observer.leads]) for field in ("bias1", "bias2")
    )
    damps = (drag > 0.0) & (stiff > 0.0)
    if not damps.any():
        return False
    share = psi[: len(own)][own][damps] * stiff[damps] / drag[damps]
    return bool(least < np.median(share) < _SHARE[1])
