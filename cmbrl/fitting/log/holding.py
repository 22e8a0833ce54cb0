"""What predicting that nothing moves, or that all goes on as it does, leaves of a log."""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.windows import Windows, huber


def losses_of_holding(evidence: Evidence, windows: Windows, threshold: float) -> np.ndarray:
    """Mean losses (2, nv) of the positions in ``windows``, by either guess; ``threshold`` of Huber's loss."""
    log, starts, horizon = evidence.log, windows.starts, windows.horizon
    rows, v = starts[:, None] + np.arange(horizon), log.v[starts][:, None]
    moved = -evidence.model.scene.difference(log.q_next[rows], log.q[starts][:, None])
    held = log.dt * v * np.arange(1.0, horizon + 1.0)[:, None]
    off = [(moved - guess) / windows.scales.q for guess in (0.0, held)]
    return np.array([huber(each, threshold).mean(axis=(0, 1)) for each in off])


def loss_of_holding(evidence: Evidence, windows: Windows, threshold: float) -> float:
    """That of the better guess, over all coordinates."""
    return float(losses_of_holding(evidence, windows, threshold).sum(axis=1).min())
