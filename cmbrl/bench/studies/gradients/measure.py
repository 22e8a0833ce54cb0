"""Bias, variance and cost of one estimator on one system over one horizon, against a reference with its own error."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.gradients.contenders import Contender
from cmbrl.bench.studies.gradients.systems import System
from cmbrl.bench.timing import interleaved
from cmbrl.gradients import Estimate, finite_differences
from cmbrl.models.complementarity import SolverWarning

HUGE = 1e300  #: larger numbers, and those that are not numbers, are written as this: JSON has neither


@dataclass(frozen=True)
class Quality:
    """Relative to the norm of the true gradient: bias with its standard error, root of the variance of one sample.

    ``reference_error``: standard error of the true gradient itself. ``failed``: samples that were not finite;
    ``unsolved``: contact solves that failed; ``steps``: model steps of one sample.
    """

    system: str
    horizon: int
    contender: str
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


def judge(
    system: System, horizon: int, contenders: list[Contender], samples: int, seed: int, folder: Path | None = None
) -> list[Quality]:
    """Every contender against central differences of the hard return, on the same initial states.

    The reference averages over +- ``system.spread`` in each parameter, so that jumps count; its samples and a
    contender's share their initial states, which takes their common noise out of the bias. With ``folder`` finished
    cells are kept there.
    """
    key = {"system": system.name, "horizon": horizon, "samples": samples, "seed": seed, "at": system.at.tolist()}

    def cell(name: str, what: dict[str, Any], compute: Any) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SolverWarning)  # counted instead
            return kept(folder / f"{name}.json", {**key, **what}, compute) if folder else compute()

    def reference_rows() -> list[list[float]]:
        objective = system.rollout(system.model(), horizon, samples, seed)
        return finite_differences(objective, system.at, system.spread, samples).gradients.tolist()

    label = f"{system.name}_{horizon}".replace(" ", "_")
    rows = cell(f"{label}_reference", {"spread": system.spread}, reference_rows)
    reference = Estimate(np.array(rows), 0)
    out = []
    for contender in contenders:
        name = f"{label}_{contender.name}".replace(" ", "_").replace(",", "")
        found = cell(
            name, {"contender": asdict(contender)}, lambda c=contender: _quality(system, horizon, c, reference, seed)
        )
        out.append(Quality(**found))
    return out


def _quality(system: System, horizon: int, contender: Contender, reference: Estimate, seed: int) -> dict[str, Any]:
    samples = len(reference.gradients)
    with np.errstate(over="ignore", invalid="ignore"):
        estimate, unsolved = contender.estimate(system, horizon, samples, seed)
        paired = Estimate(estimate.gradients - reference.gradients, 0)
        norm = float(np.linalg.norm(reference.mean))
        quality = Quality(
            system.name, horizon, contender.name, contender.family, contender.length, contender.bundle,
            _finite(np.linalg.norm(paired.mean) / norm), _finite(paired.standard_error / norm),
            _finite(np.sqrt(estimate.total_variance) / norm), _finite(reference.standard_error / norm), norm,
            estimate.failed, unsolved, estimate.steps / samples,
        )  # fmt: skip
    return asdict(quality)


def costs(system: System, horizon: int, contenders: list[Contender], samples: int, repeats: int) -> dict[str, float]:
    """Microseconds of processor time a sample, contenders taking turns, median of the turns."""
    work = {c.name: ((lambda c=c: c.estimate(system, horizon, samples, 0)), samples) for c in contenders}
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", SolverWarning)
        seconds = interleaved(work, repeats)
    return {name: float(1e6 * np.median(values)) for name, values in seconds.items()}


def _finite(x: Any) -> float:
    return float(x) if np.isfinite(x) and abs(x) < HUGE else HUGE
