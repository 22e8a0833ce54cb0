"""Rates at which servos' own targets may follow their commands, as the motion of a log shows them.

A drive with a profile velocity lets its target move no faster than that, so its joint moves at that speed for long, and
not where the command would have it. A ramp that nothing reaches has hardly a derivative. So fits begin at rates about
the largest usual speed of each joint, where commands ask for more.
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.models.between.parameters import RAMP

_USUAL = 0.98  # of the rows: slower
_MORE = 1.15  # times the usual speed of the joint: the usual rate of its commands, at least
_ABOUT = (1.1, 0.95, 0.8, 0.65)  # times it: joints overshoot


def shown_ramps(loss: PredictionLoss, theta: np.ndarray) -> list[list[dict[str, float]]]:
    """By servo whose commands ask for more than its joint does: ramps to try, by name, at parameters ``theta`` (n,)."""
    observer, scene = loss.observation, loss.model.scene
    log, psi = loss.windows.data, observer.split(theta)[1]
    seen = observer.states(log, np.where(np.arange(len(psi)) < len(observer), 0.0, psi))
    within = np.diff(log.episode) == 0
    asked = np.abs(np.diff(log.u[:, : scene.nu], axis=0))[within] / log.dt
    moved = np.abs(seen.v[:, observer.joints_v] @ observer.reading.T)
    found = []
    for k in observer.leads.tolist():
        usual = float(np.quantile(moved[:, k], _USUAL))
        if usual > 0.0 and len(asked) and float(np.quantile(asked[:, k], _USUAL)) > _MORE * usual:
            found.append([{f"{RAMP}.{scene.actuator_names[k]}": 1.0 / (share * usual)} for share in _ABOUT])
    return found
