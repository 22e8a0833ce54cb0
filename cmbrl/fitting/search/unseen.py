"""What a fit was judged on, kept so that it can be looked at: held-out rows, and parameters fitted without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.models.between.observation import Observation
from cmbrl.models.windows import blocks_of


@dataclass(frozen=True)
class Unseen:
    """By fold, the held-out ``rows`` (N,) of ``log`` and the ``theta`` (n,) fitted to the others.

    ``horizon`` steps were judged. ``theta`` and ``nominal`` (n,) are the parameters of the model, then those of
    ``observation``.
    """

    log: Transitions
    observation: Observation
    horizon: int
    nominal: np.ndarray
    rows: tuple[np.ndarray, ...]
    theta: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, held_out: Sequence[PredictionLoss], theta: Sequence[np.ndarray], nominal: np.ndarray) -> Unseen:
        """Of the losses ``held_out`` by fold, and the parameters fitted to the others."""
        windows, rows = held_out[0].windows, held_out_rows(held_out)
        return cls(windows.data, held_out[0].observation, windows.horizon, nominal, rows, tuple(theta))


def held_out_rows(held_out: Sequence[PredictionLoss]) -> tuple[np.ndarray, ...]:
    """Rows of each loss: those of its blocks, also where only some windows are judged."""
    block = blocks_of(held_out[0].windows.data)
    return tuple(np.flatnonzero(np.isin(block, loss.windows.blocks)) for loss in held_out)
