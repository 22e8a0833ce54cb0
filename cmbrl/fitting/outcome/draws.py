"""Draws around a fit: normal with its covariance, but no wider than the log bears.

Intervals are widened by what other horizons and time steps would make of the fit, so that they hold the truth where the
model is wrong. Parameters that are that far off all at once explain the log far worse than the fit, and often worse
than the file: a policy that is trained on such draws spends itself on robots that the log rules out. So the standard
deviations are scaled down together until draws explain the log about as well as the fit.

A delay that the log leaves open is drawn although the fit has none (``untold_delay``). Deviations are as likely as
their opposites, so one that has a delay below 0 is turned around as a whole.
"""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.space import Space

WORSE = 0.25  #: how much larger than the fit's the loss of a draw may be, as a share,
LOST = 0.05  #: or how much of the gain over the file it may lose, if that is more: of half of the draws
_SHARES, _SEED = 2.0 ** (-0.5 * np.arange(13)), 0
_COUNTED = 40  # steps of a window; those of longer ones do not make windows fewer


def around(
    z: np.ndarray, places: np.ndarray, covariance: np.ndarray, count: int, seed: int, delay: int | None = None
) -> np.ndarray:
    """Draws (count, n) around ``z`` (n,), with ``covariance`` (k, k) at ``places`` (k,).

    ``delay``: the one of the places at which they are ``z`` or more.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    deviation = np.random.default_rng(seed).normal(size=(count, len(places))) @ root.T
    if delay is not None:
        deviation *= np.where(deviation[:, places == delay] < 0.0, -1.0, 1.0)
    drawn = np.tile(z, (count, 1))
    drawn[:, places] += deviation
    return drawn


def bearable(
    loss: PredictionLoss,
    space: Space,
    z: np.ndarray,
    covariance: np.ndarray,
    tried: int = 32,
    rows: int = 4000,
    delay: int | None = None,
) -> float:
    """The share of their standard deviations by which parameters may be drawn, at most 1; ``covariance`` (n, n) in z.

    So is what lies between log and model (biases, delay, lag). About ``rows`` are predicted for each of the draws
    ``tried``: enough for a median over draws. ``delay``: as in ``around``.
    """
    places = np.flatnonzero(np.diag(covariance) > 0.0)
    if not len(places):
        return 1.0
    drawn = around(z, places, covariance[np.ix_(places, places)], tried, _SEED, delay)
    starts, most = loss.windows.starts, max(1, rows // min(loss.windows.horizon, _COUNTED))
    loss = loss.on(starts[:: -(-len(starts) // most)]).settled(space.theta(z))
    fitted, file = loss.values(np.stack([space.theta(z), space.nominal]))
    bound = fitted + max(WORSE * abs(fitted), LOST * (file - fitted) if np.isfinite(file) else 0.0)

    def bears(share: float) -> bool:
        moved = space.theta(np.clip(z + share * (drawn - z), space.z_low, space.z_high))
        return bool(2 * np.count_nonzero(loss.values(moved, most=bound) <= bound) >= len(moved))

    # What is wider explains the log worse, so the widest is found by halves; the narrowest is taken as it is.
    return float(_SHARES[bisect_left(range(len(_SHARES) - 1), True, key=lambda k: bears(float(_SHARES[k])))])
