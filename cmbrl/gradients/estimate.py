"""What every gradient estimator returns, and what it is asked to differentiate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]


class Objective(Protocol):
    """Independent samples of a scalar: values (B,) of the arguments x (B, n), float64, each of its own row alone.

    Row i must use the same randomness (initial state, noise) whenever it is asked, so that differences between two
    calls are differences in x.
    """

    @property
    def steps(self) -> int:
        """Model steps that one sample costs."""
        ...

    def __call__(self, x: Tensor) -> Tensor:
        """Values (B,) at x (B, n)."""
        ...


@dataclass(frozen=True)
class Estimate:
    """A gradient as a mean of independent samples.

    ``mean`` (n,); ``variance`` (n,) of ONE sample, unbiased, so that the mean has variance / samples; ``steps``: model
    steps taken in all, ``derivative_steps``: how many of them were also differentiated; ``failed``: samples that were
    not finite and are in neither mean nor variance.
    """

    mean: Array
    variance: Array
    samples: int
    steps: int
    derivative_steps: int = 0
    failed: int = 0

    @classmethod
    def of(cls, gradients: Array, steps: int, derivative_steps: int = 0) -> Estimate:
        """From per-sample gradients (N, n); rows that are not finite are left out and counted."""
        finite = np.isfinite(gradients).all(axis=1)
        kept = gradients[finite]
        if not len(kept):
            nothing = np.full(gradients.shape[1], np.nan)
            return cls(nothing, nothing, 0, steps, derivative_steps, len(gradients))
        variance = kept.var(axis=0, ddof=1) if len(kept) > 1 else np.full(kept.shape[1], np.nan)
        return cls(kept.mean(axis=0), variance, len(kept), steps, derivative_steps, int((~finite).sum()))

    @property
    def standard_error(self) -> float:
        """Of the mean as a vector: square root of the trace of its covariance."""
        return float(np.sqrt(self.variance.sum() / self.samples)) if self.samples else float("nan")

    @property
    def total_variance(self) -> float:
        """Trace of the covariance of one sample."""
        return float(self.variance.sum())
