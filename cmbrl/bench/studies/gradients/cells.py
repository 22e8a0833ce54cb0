"""Bias, variance and cost of estimators on one system over one horizon, against a reference with an error estimate."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.bench.studies.gradients.arms import Arm
from cmbrl.bench.studies.gradients.systems import SYSTEMS, System
from cmbrl.bench.timing import interleaved
from cmbrl.gradients import Estimate, finite_differences
from cmbrl.models.native_step.result import SolverWarning

HUGE = 1e300  #: stands for larger numbers and for those that are not finite


@dataclass(frozen=True)
class Quality:
    """Relative to the norm of the true gradient: bias with its standard error, root of the variance of one sample.

    ``reference_error``: standard error of the true gradient. ``failed``: samples that were not finite; ``unsolved``:
    contact solves that failed; ``steps``: model steps of one sample.
    """

    system: str
    horizon: int
    arm: str
    family: str
    length: float | None
    bundle: int | None
    bias: float
    bias_error: float
    deviation: float
    reference_error: float
    norm: float
    failed: int
    unsolved: int
    steps: float

    @property
    def resolved(self) -> bool:
        """Whether the bias is more than twice its standard error."""
        return self.bias > 2 * self.bias_error


def judge(system: str, horizon: int, arms: Sequence[Arm], samples: int, seed: int) -> list[Quality]:
    """Every arm against central differences of the hard return, on the same initial states.

    The reference averages over +- ``spread`` of the system in each parameter, so that jumps count. It shares its
    initial states with the arms, so that their common noise cancels in the bias.
    """
    made = SYSTEMS[system]()
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", SolverWarning)  # counted instead
        objective = made.rollout(made.model(), horizon, samples, seed)
        reference = Estimate(finite_differences(objective, made.at, made.spread, samples).gradients, 0)
        return [_quality(made, horizon, arm, reference, seed) for arm in arms]


def _quality(system: System, horizon: int, arm: Arm, reference: Estimate, seed: int) -> Quality:
    samples = len(reference.gradients)
    estimate, unsolved = arm.estimate(system, horizon, samples, seed)
    paired = Estimate(estimate.gradients - reference.gradients, 0)
    norm = float(np.linalg.norm(reference.mean))
    return Quality(
        system.name, horizon, arm.name, arm.family, arm.length, arm.bundle,
        _finite(np.linalg.norm(paired.mean) / norm), _finite(paired.standard_error / norm),
        _finite(np.sqrt(estimate.total_variance) / norm), _finite(reference.standard_error / norm), norm,
        estimate.failed, unsolved, estimate.steps / samples,
    )  # fmt: skip


def costs(system: str, horizon: int, arms: Sequence[Arm], samples: int, repeats: int) -> dict[str, float]:
    """Microseconds of processor time a sample, by arm: median of turns, which the arms take in order."""
    made = SYSTEMS[system]()
    work = {arm.name: ((lambda arm=arm: arm.estimate(made, horizon, samples, 0)), samples) for arm in arms}
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", SolverWarning)
        seconds = interleaved(work, repeats)
    return {name: float(1e6 * np.median(values)) for name, values in seconds.items()}


def _finite(x: Any) -> float:
    return float(x) if np.isfinite(x) and abs(x) < HUGE else HUGE
