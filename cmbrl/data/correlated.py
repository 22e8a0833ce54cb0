"""After how many samples noise has forgotten itself: neighbours that share it say nothing about each other's.

Stamps that jitter, repeated readings and counts that a slow joint hardly leaves give neighbouring samples the same
error. What a sample's neighbours miss it by is then far less than the noise, and the least of the narrowest windows:
cross-validation follows the noise (Chu and Marron, Annals of Statistics 19, 1991, whose remedy is to leave those
neighbours out). Sixth differences over a stride leave noise and hardly any motion. Of white noise they are the same for
all strides. Of noise that lasts they grow up to where it is forgotten, and stay there; what motion leaves grows on.
"""

from __future__ import annotations

import numpy as np

STRIDES = (1, 2, 4, 8, 16)
_FIRST, _SIXTH = np.array([-1.0, 1.0]), np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])
_LONGEST = 0.01  # [s]: motion repeats itself, too, and what lasts longer is not told from it
_GROWN, _STAYS = 1.5, 1.15  # times: what is no white noise; what no longer grows
_OF_MOTION = 0.1  # of how far a stride leads, which noise is less than


def lasts(samples: np.ndarray, dt: float, parts: list[slice]) -> np.ndarray:
    """For how many samples (n,) the noise of columns of ``samples`` (T, n) lasts; 1: it is white, or not to be told.

    ``dt`` [s]: from sample to sample; ``parts``: the rows of each episode.
    """
    found = np.ones(samples.shape[1], dtype=np.int64)
    noise = [_differences(samples, parts, stride, _SIXTH) for stride in STRIDES if stride * dt <= 2 * _LONGEST]
    for k, (stride, own) in reversed([*enumerate(zip(STRIDES, noise, strict=False))][1:-1]):
        stays = (own > _GROWN * noise[0]) & (noise[k + 1] <= _STAYS * own)
        found[stays & (own < _OF_MOTION * _differences(samples, parts, stride, _FIRST))] = stride
    return found


def _differences(samples: np.ndarray, parts: list[slice], stride: int, weights: np.ndarray) -> np.ndarray:
    """Root mean square (n,) of differences over a ``stride``, as of white noise; infinite where episodes are short."""
    squares, count, reach = np.zeros(samples.shape[1]), 0, (len(weights) - 1) * stride
    for part in parts:
        x = samples[part]
        if (rows := len(x) - reach) > 0:
            off = sum(c * x[k * stride : k * stride + rows] for k, c in enumerate(weights))
            squares += np.square(off).sum(axis=0)
            count += rows
    return np.sqrt(squares / (count * np.square(weights).sum())) if count else np.full(samples.shape[1], np.inf)
