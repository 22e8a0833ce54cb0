"""What a loss tells of one parameter set: errors by window, and its Gauss-Newton model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.fitting.search.starts import Follow

ALIKE = 10  # rows that count as one where windows are too short to tell; see ``objective``
_UNCORRELATED = 0.05  # a correlation below this ends the sum


def alike_rows(residual: np.ndarray) -> float:
    """Integrated correlation time [rows] of residuals (windows, steps, coordinates) along the windows: 1 for noise.

    Windows of fewer than ALIKE steps cannot tell, nor can none: ALIKE.
    """
    steps = residual.shape[1]
    if not residual.size:
        return float(ALIKE)
    square = float((residual**2).mean())
    if steps < ALIKE or square == 0.0:
        return float(ALIKE)
    total = 1.0
    for lag in range(1, steps // 2):
        correlation = float((residual[:, lag:] * residual[:, :-lag]).mean()) / square
        if not correlation > _UNCORRELATED:
            break
        total += 2.0 * correlation
    return total


@dataclass(frozen=True)
class Errors:
    """Errors of one parameter set: ``loss`` (n,) and mean ``squares`` (n,) of residuals by start; failed steps.

    ``alike``: neighbouring rows whose residuals count as one (see :func:`alike_rows`).
    """

    loss: np.ndarray
    squares: np.ndarray
    failures: int
    alike: float

    @property
    def mean(self) -> float:
        """Mean loss."""
        return float(self.loss.mean())

    @property
    def rmse(self) -> float:
        """Root mean square of the normalised residuals over all coordinates."""
        return float(np.sqrt(self.squares.mean()))


@dataclass(frozen=True)
class NormalEquations:
    """Gauss-Newton model of the loss in z: gradient (n,), its parts by episode (episodes, n), and hessian (n, n).

    ``independent`` is the number of residual vectors that count, ``variance`` the mean Huberised squared residual.
    ``follow``: how the starts of windows follow z in a noisy log; they are eliminated from the rest. ``root`` (m, n):
    that of the hessian (``square_root``), more exact than the hessian where no starts were eliminated.
    """

    gradient: np.ndarray
    hessian: np.ndarray
    episode_gradients: np.ndarray
    independent: float
    variance: float
    follow: Follow | None = None
    root: np.ndarray | None = None
