"""What every gradient estimator returns, and what it differentiates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]


class Objective(Protocol):
    """Independent samples of a scalar: values (B,) at arguments x (B, n), float64, each depending on its own row only.

    Row i must use the same randomness (initial state, noise) in every call, so that two calls differ only by x.
    """

    @property
    def steps(self) -> int:
        """Model steps per sample."""
        ...

    def __call__(self, x: Tensor) -> Tensor:
        """Values (B,) at x (B, n)."""
        ...


@dataclass(frozen=True)
class Estimate:
    """A gradient as the mean of independent samples.

    ``gradients`` (N, n): one row per sample, in the order of the objective's randomness. Rows that are not finite are
    excluded from mean and variance and counted in ``failed``. ``steps``: model steps taken; ``derivative_steps``: how
    many of them were differentiated.
    """

    gradients: Array
    steps: int
    derivative_steps: int = 0

    @cached_property
    def _finite(self) -> Array:
        return self.gradients[np.isfinite(self.gradients).all(axis=1)]

    @property
    def samples(self) -> int:
        """Number of samples in the mean."""
        return len(self._finite)

    @property
    def failed(self) -> int:
        """Samples that were not finite."""
        return len(self.gradients) - self.samples

    @property
    def mean(self) -> Array:
        """(n,); NaN without a finite sample."""
        return self._finite.mean(axis=0) if self.samples else np.full(self.gradients.shape[1], np.nan)

    @property
    def variance(self) -> Array:
        """(n,) of ONE sample, unbiased; that of the mean is variance / samples. NaN for fewer than two samples."""
        return self._finite.var(axis=0, ddof=1) if self.samples > 1 else np.full(self.gradients.shape[1], np.nan)

    @property
    def total_variance(self) -> float:
        """Trace of the covariance of one sample."""
        return float(self.variance.sum())

    @property
    def standard_error(self) -> float:
        """Of the mean as a vector: square root of the trace of its covariance."""
        return float(np.sqrt(self.total_variance / self.samples)) if self.samples else float("nan")
