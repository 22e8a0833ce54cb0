"""Positions and velocities from sampled positions: local polynomials, as smooth as the samples themselves support.

Each column gets the degree and half-width at which a sample is best predicted by its neighbours (leave-one-out error),
so that a quiet encoder is hardly smoothed and a noisy one is, and a robot that moves much between samples keeps its
speed (Savitzky and Golay, Analytical Chemistry 36, 1964; the choice by cross-validation: Fan and Gijbels, Local
Polynomial Modelling, 1996, section 4.6). Neighbours whose noise a sample shares do not count there (``correlated``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.data.correlated import lasts
from cmbrl.scene.manifold import rotate_by, rotation_between

_HALF_WIDTHS = (2, 3, 4, 6, 8, 12, 16)  # samples on each side
_WIDER, _LONGEST = (24, 32, 48, 64), 0.064  # the same of fast logs, up to so long [s]
_DEGREES = (2, 4)
_LEAST = 5  # samples of an episode that a parabola can smooth
_AT_ONCE = 10_000  # rows whose neighbours are in memory together


@dataclass(frozen=True)
class Smoothed:
    """``value`` and ``rate`` (T, n) of each sample and column; ``noise`` (n,): that of the measurement."""

    value: np.ndarray
    rate: np.ndarray
    noise: np.ndarray


def smooth(samples: np.ndarray, dt: float, episode: np.ndarray) -> Smoothed:
    """Smooths the columns of ``samples`` (T, n), ``dt`` [s] apart within each ``episode`` (T,).

    Episodes of fewer than 5 samples keep their values, with differences as rates.
    """
    parts = [slice(int(rows[0]), int(rows[-1]) + 1) for rows in _blocks(episode)]
    polynomials = _polynomials(max(part.stop - part.start for part in parts), dt)
    shared = lasts(samples, dt, parts)
    squares = np.stack([_squares_left(polynomial, samples, parts, shared) for polynomial in polynomials])
    best, columns = squares.argmin(axis=0), np.arange(samples.shape[1])
    value, rate = np.empty_like(samples), np.empty_like(samples)
    for k in np.unique(best).tolist():  # only what is best is kept: all of them are many times the log
        own = best == k
        value[:, own], rate[:, own] = _with(polynomials[k], samples[:, own], dt, parts)
    return Smoothed(value, rate, np.sqrt(squares[best, columns]))


def _with(
    polynomial: tuple[int, int], samples: np.ndarray, dt: float, parts: list[slice]
) -> tuple[np.ndarray, np.ndarray]:
    """Values and rates."""
    value, rate = samples.copy(), np.zeros_like(samples)
    for part in parts:
        x = samples[part]
        if len(x) < _LEAST:
            if len(x) > 1:
                rate[part] = np.gradient(x, dt, axis=0)
            continue
        half, weights = _weights(polynomial, len(x))
        value[part] = _applied(weights[0], x, half)
        rate[part] = _applied(weights[1], x, half) / dt
    return value, rate


def _applied(weights: np.ndarray, x: np.ndarray, half: int) -> np.ndarray:
    """``weights`` (w, w) of the places in a window, for each row of ``x`` (T, n); at the ends it is not central."""
    before, after = weights[:half] @ x[: len(weights)], weights[half + 1 :] @ x[-len(weights) :]
    return np.concatenate([before, _central(weights[half], x), after])


def _central(weights: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The same (T - w + 1, n) of the rows whose window is central, by its ``weights`` (w,)."""
    found = np.empty((len(x) - len(weights) + 1, x.shape[1]))
    for k, column in enumerate(np.ascontiguousarray(x.T)):
        found[:, k] = np.correlate(column, weights, "valid")
    return found


def _squares_left(
    polynomial: tuple[int, int], samples: np.ndarray, parts: list[slice], shared: np.ndarray
) -> np.ndarray:
    """Mean square (n,) of what is left of a sample when its neighbours alone predict it.

    Of columns whose noise is ``shared`` (n,) by so many samples, those neighbours are not asked.
    """
    squares, count = np.zeros(samples.shape[1]), 0
    for part in parts:
        x = samples[part]
        if len(x) < _LEAST:
            continue
        half, weights = _weights(polynomial, len(x))
        central = weights[0][half]
        left = (x[half : len(x) - half] - _central(central, x)) / (1.0 - central[half])
        squares += np.square(left).sum(axis=0)
        count += len(left)
    found = squares / max(count, 1)
    for lag in np.unique(shared[shared > 1]).tolist():
        own = shared == lag
        found[own] = _predicted(polynomial, samples[:, own], parts, lag)
    return found


def _predicted(polynomial: tuple[int, int], samples: np.ndarray, parts: list[slice], count: int) -> np.ndarray:
    """Mean squares (n,) of what is left of a sample that only those predict which are ``count`` or more away."""
    squares, rows = np.zeros(samples.shape[1]), 0
    for part in parts:
        x = samples[part]
        half = min(polynomial[1], (len(x) - 1) // 2)
        steps = np.arange(-half, half + 1)
        away = np.abs(steps) >= count
        if away.sum() <= polynomial[0] + 1:
            return np.full(samples.shape[1], np.inf)
        powers = steps[away, None] ** np.arange(polynomial[0] + 1)
        weights = np.zeros(2 * half + 1)
        weights[away] = np.linalg.pinv(powers.astype(float))[0]
        left = x[half : len(x) - half] - _central(weights, x)
        squares += np.square(left).sum(axis=0)
        rows += len(left)
    return squares / max(rows, 1)


def smooth_rotations(quaternions: np.ndarray, dt: float, episode: np.ndarray) -> Smoothed:
    """The same for unit ``quaternions`` (T, 4): smoothed ones, their rates (T, 3) [rad/s] in the axes of the body.

    The polynomials are in the rotation vectors from each sample to its neighbours; one kind serves all three axes.
    """
    parts = [slice(int(rows[0]), int(rows[-1]) + 1) for rows in _blocks(episode)]
    longest = max(part.stop - part.start for part in parts)
    trials = [_rotations_with(polynomial, quaternions, dt, parts) for polynomial in _polynomials(longest)]
    value, rate, error = min(trials, key=lambda trial: float(trial[2].sum()))
    return Smoothed(value, rate, np.sqrt(error))


def _rotations_with(
    polynomial: tuple[int, int], quaternions: np.ndarray, dt: float, parts: list[slice]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quaternions, rates, and the mean squares (3,) of what is left of a sample that its neighbours predict."""
    value, rate = quaternions.copy(), np.zeros((len(quaternions), 3))
    squares, count = np.zeros(3), 0
    for part in parts:
        samples = quaternions[part]
        rows = len(samples)
        if rows < _LEAST:
            if rows > 1:
                step = rotation_between(samples[:-1], samples[1:]) / dt
                rate[part] = np.concatenate([step, step[-1:]])
            continue
        half, weights = _weights(polynomial, rows)
        first = np.arange(rows).clip(half, rows - 1 - half) - half
        place = np.arange(rows) - first
        offset, turn = np.empty((2, rows, 3))
        for some in np.array_split(np.arange(rows), -(-rows // _AT_ONCE)):
            near = samples[first[some, None] + np.arange(2 * half + 1)]  # (s, w, 4)
            away = rotation_between(np.broadcast_to(samples[some, None], near.shape), near)
            offset[some] = np.einsum("rwn,rw->rn", away, weights[0][place[some]])
            turn[some] = np.einsum("rwn,rw->rn", away, weights[1][place[some]])
        rate[part], value[part] = turn / dt, rotate_by(samples, offset)
        left = offset / (1.0 - weights[0][place, place])[:, None]
        squares += (left[half : rows - half] ** 2).sum(axis=0)
        count += rows - 2 * half
    return value, rate, squares / max(count, 1)


def _polynomials(longest: int, dt: float = np.inf) -> list[tuple[int, int]]:
    """Degrees and half-widths that an episode of ``longest`` samples may have, those of parabolas first."""
    wider = [width for width in _WIDER if width * dt <= _LONGEST]
    widths = [width for width in (*_HALF_WIDTHS, *wider) if 2 * width < longest] or _HALF_WIDTHS[:1]
    return [(degree, width) for degree in _DEGREES for width in widths if 2 * width > degree]


def _weights(polynomial: tuple[int, int], rows: int) -> tuple[int, np.ndarray]:
    """The half-width in an episode of ``rows`` samples, and (2, w, w): weights of a value and a rate at each place."""
    degree, width = polynomial
    half = min(width, (rows - 1) // 2)
    degree = degree if 2 * half > degree else _DEGREES[0]
    steps = np.arange(-half, half + 1)
    powers = steps[:, None] ** np.arange(degree + 1)
    inverse = np.linalg.pinv(powers.astype(float))  # (degree + 1, w)
    slopes = np.arange(1, degree + 1) * powers[:, :-1]
    return half, np.stack([powers @ inverse, slopes @ inverse[1:]])


def _blocks(episode: np.ndarray) -> list[np.ndarray]:
    return np.split(np.arange(len(episode)), np.flatnonzero(np.diff(episode)) + 1)
