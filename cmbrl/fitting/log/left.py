"""How much of each coordinate's change a model leaves unexplained, where positions of what drifts were logged.

A capture tells six coordinates of a base, of which a rover hardly moves three: all that is left of them is noise. An
encoder tells a wheel a hundred times as well. Measured by the change of each coordinate alone, errors of the base rule
how large the errors of the model seem, and with that how far the prior holds back what the wheels tell. So errors are
measured by what a short fit leaves of each coordinate, as in generalised least squares with an unknown variance each
(Zellner 1962): a coordinate of which little is left has a smaller unit.
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.folds import draw_starts

_TO_DEVIATION = 1.2533  # of a normal distribution, from its mean absolute deviation
_SEED = 0


def left_of_changes(
    evidence: Evidence, z: np.ndarray, horizon: int, huber: float, noise: np.ndarray | None, rows: int
) -> np.ndarray:
    """Shares (nv,) of the change over ``horizon`` steps by which predictions at ``z`` (n,) err; 1 for what none tells.

    About ``rows`` rows are predicted, from starts that are free within ``noise`` (logs, 2 nv).
    """
    theta, nv = evidence.space.theta(z), evidence.model.scene.nv
    starts = draw_starts(evidence.log, horizon, rows, _SEED)
    loss = evidence.loss(starts, horizon, *evidence.scales(horizon, huber, noise))
    off = np.abs(loss.settled(theta).residuals(theta)[0]).mean(axis=(0, 1))
    found = np.ones(2 * nv)
    found[loss.windows.scales.counts] = np.nan_to_num(_TO_DEVIATION * off, nan=1.0)
    return found[:nv]
