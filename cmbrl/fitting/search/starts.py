"""Where the windows of a noisy log start: free within the noise, and settled anew for every set of parameters.

A window from a measured state carries that state's error through all its steps, and no parameter can explain it. So
each window has its own start, as in multiple shooting. It pays for its distance d from the measured state,

    J_s(theta, d) = sum_(j, c) rho(r_sjc) + sum_c rho(d_sc / sigma_c),

with sigma_c the standard deviation of the noise in the units of the loss. For given parameters the windows are
independent small problems: a damped Gauss-Newton for each, all in one batch. For parameters that move by dz the starts
follow, and eliminating them (a Schur complement) leaves equations in z alone: to first order, the residuals weighted by
the inverse of their covariance R + J0 S J0^T (generalised least squares). Without noise nothing of this happens.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

_ITERATIONS = 8
_ENOUGH = 1e-3  # of the cost of all windows: smooth motion gains less after one iteration, contacts after several
_RIDGE = 1e-10  # share of the diagonal
_DAMPING = (1e-4, 0.1, 10.0)  # at first, after a success, after a failure


@dataclass(frozen=True)
class StartEquations:
    """Gauss-Newton models of windows in their starts: ``gradient`` (s, k), ``hessian`` (s, k, k)."""

    gradient: np.ndarray
    hessian: np.ndarray

    @classmethod
    def of(
        cls,
        residual: np.ndarray,
        weight: np.ndarray,
        slope: np.ndarray,
        offset: np.ndarray,
        precision: np.ndarray,
        delta: float,
    ) -> StartEquations:
        """From residuals (s, w), their weights and slopes (s, w, k) in the starts at ``offset`` (s, k).

        ``precision`` (s, k) or (1, k): inverse standard deviations of the starts.
        """
        away = offset * precision
        pull = np.minimum(1.0, delta / np.maximum(np.abs(away), 1e-300)) * precision**2
        gradient = ((weight * residual)[:, None] @ slope)[:, 0] + pull * offset
        hessian = slope.transpose(0, 2, 1) @ (weight[:, :, None] * slope)
        k = np.arange(offset.shape[1])
        hessian[:, k, k] += pull
        return cls(gradient, hessian)

    def solve(self, right: np.ndarray, damping: float | np.ndarray = 0.0) -> np.ndarray:
        """Solutions (s, k, ...) for right-hand sides, with the diagonals larger by the share ``damping``."""
        hessian = self.hessian.copy()
        k = np.arange(hessian.shape[1])
        hessian[:, k, k] *= 1.0 + np.reshape(damping, (-1, 1))
        try:
            return np.linalg.solve(hessian, right)
        except np.linalg.LinAlgError:  # slopes of a window that blows up are parallel to the last digit
            return _solve_regular(hessian, right)


def _solve_regular(hessian: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The same with unit diagonals, and a little more, so that none is singular."""
    k = np.arange(hessian.shape[1])
    size = 1.0 / np.sqrt(np.maximum(hessian[:, k, k], 1e-300))
    scaled = hessian * size[:, :, None] * size[:, None, :]
    scaled[:, k, k] += _RIDGE
    return np.asarray(size[:, :, None] * np.linalg.solve(scaled, size[:, :, None] * right))


@dataclass(frozen=True)
class Follow:
    """How the best starts follow the parameters: offset + shift + slope dz, (s, k) and (s, k, n)."""

    shift: np.ndarray
    slope: np.ndarray

    @classmethod
    def of(cls, moved: np.ndarray, columns: np.ndarray, n: int) -> Follow:
        """From ``moved`` (s, k, 1 + c): the shift, and the slope in those ``columns`` (c,) of ``n`` that are not 0."""
        slope = np.zeros((*moved.shape[:2], n))
        slope[:, :, columns] = moved[:, :, 1:]
        return cls(moved[:, :, 0], slope)

    @classmethod
    def joined(cls, parts: Sequence[Follow]) -> Follow:
        """One of all windows."""
        return cls(np.concatenate([p.shift for p in parts]), np.concatenate([p.slope for p in parts]))

    def only(self, windows: np.ndarray) -> Follow:
        """The same of those ``windows`` (s,) bool; the others' starts stay where they are."""
        return Follow(np.where(windows[:, None], self.shift, 0.0), np.where(windows[:, None, None], self.slope, 0.0))

    def at(self, offset: np.ndarray, dz: np.ndarray) -> np.ndarray:
        """The offsets (C, s, k) after each of the steps ``dz`` (C, n)."""
        return offset + self.shift + np.moveaxis(self.slope @ dz.T, -1, 0)


class Settling:
    """The damped Gauss-Newton iteration of all windows at once.

    ``linearise(offset)`` gives residuals (s, w) and slopes (s, w, k) at offsets (s, k); ``cost(residual, offset)`` is
    (s,).
    """

    def __init__(
        self,
        linearise: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
        cost: Callable[[np.ndarray, np.ndarray], np.ndarray],
        precision: np.ndarray,
        delta: float,
    ) -> None:
        self.linearise, self.cost, self.precision, self.delta = linearise, cost, precision, delta

    def run(self, offset: np.ndarray) -> np.ndarray:
        """The offsets (s, k) of least cost near ``offset``; a window that cannot be linearised keeps its own."""
        best = offset.copy()
        residual, slope = self.linearise(best)
        value = self.cost(residual, best)
        damping = np.full(len(best), _DAMPING[0])
        for _ in range(_ITERATIONS):
            sound = np.isfinite(slope).all(axis=(1, 2)) & np.isfinite(residual).all(axis=1)
            r, x = np.where(sound[:, None], residual, 0.0), np.where(sound[:, None, None], slope, 0.0)
            weight = np.minimum(1.0, self.delta / np.maximum(np.abs(r), 1e-300))
            equations = StartEquations.of(r, weight, x, best, self.precision, self.delta)
            step = equations.solve(-equations.gradient[..., None], damping)[..., 0]
            tried = np.where(sound[:, None], best + step, best)
            tried_residual, tried_slope = self.linearise(tried)
            tried_value = self.cost(tried_residual, tried)
            better = tried_value < value
            gain = float((value - tried_value)[better].sum())
            best[better], value[better] = tried[better], tried_value[better]
            residual[better], slope[better] = tried_residual[better], tried_slope[better]
            damping *= np.where(better, _DAMPING[1], _DAMPING[2])
            if gain <= _ENOUGH * float(value[np.isfinite(value)].sum()):
                break
        return best
