"""Derivatives of one case under every smoothing, and errors of estimators across jumps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain

import numpy as np

from cmbrl.bench.studies.gradient_scenes import bounces, chaos, contacts, faults, jumps
from cmbrl.bench.studies.gradient_scenes.case import Array, Case
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing

KAPPAS = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  #: [J]
SMOOTHINGS: dict[str, Smoothing] = {
    "hard": Exact(),
    **{f"kappa {kappa:.0e}": Barrier(kappa) for kappa in KAPPAS},
    "gaussian": Gaussian(length=1e-3),
}
MATCH = 1e-4  #: |ours - differences| above which they disagree, relative to the larger of 1 and the derivative


@dataclass(frozen=True)
class Row:
    """One derivative. ``ours``, ``differences`` by smoothing; ``failures``: solves that did not converge."""

    label: str
    title: str
    wrt: str
    truth: float
    upper: float
    ours: dict[str, float]
    differences: dict[str, float]
    softened: dict[str, float]
    mujoco: float | None
    tolerance: float
    remark: str
    weakness: str
    failures: int

    def mismatch(self, name: str) -> float:
        """|ours - differences| at a smoothing, relative to the larger of 1 and the derivative."""
        return abs(self.ours[name] - self.differences[name]) / max(1.0, abs(self.differences[name]))

    def bias(self, value: float) -> float:
        """Distance to the truth, or to its interval, relative to the larger of 1 and the truth."""
        outside = max(self.truth - value, value - self.upper, 0.0)
        return outside / max(1.0, abs(self.truth))

    @property
    def misses(self) -> bool:
        """Whether the default (hard) derivative is further from the truth than the case tolerates."""
        return self.bias(self.ours["hard"]) > self.tolerance

    @property
    def verdict(self) -> str:
        """Of the default (hard) model; also whether all smoothings match their own differences."""
        astray = [name for name in self.ours if self.mismatch(name) > MATCH]
        if self.misses:
            return f"misses the truth: {self.weakness}"
        if astray:
            reason = f": {self.weakness}" if self.weakness else ""
            return f"truth met; differs from differences at {len(astray)} of {len(self.ours)} smoothings{reason}"
        return "pass"


@dataclass(frozen=True)
class Bundle:
    """Gradients of ``order`` across a jump from bundles of ``size``: mean and root mean square error over repeats, the
    error that a bundle reports of itself, and the variance of one sample."""

    label: str
    title: str
    order: str
    size: int
    truth: float
    mean: float
    rms: float
    reported: float
    variance: float


@cache
def all_cases() -> dict[str, Case]:
    """By name, in the order of labels."""
    over = [jumps.over_the_wall(), jumps.over_the_wall(0.0)]
    cases = chain(bounces.cases(), contacts.cases(), over, chaos.cases(), faults.cases())
    return {case.name: case for case in sorted(cases, key=lambda case: int(case.label[1:]))}


def measure(name: str) -> list[Row]:
    """One row for each parameter of the case called ``name``."""
    case = all_cases()[name]
    models = {kind: case.model(smoothing) for kind, smoothing in SMOOTHINGS.items()}
    ours = {kind: case.derivative(model) for kind, model in models.items()}
    differences = {kind: case.differences(model) for kind, model in models.items()}
    softened = {f"kappa {kappa:.0e}": case.softened(kappa) for kappa in KAPPAS} if case.softened else {}
    failures = sum(model.failures for model in models.values())
    mujoco, upper = case.mujoco_differences(), case.upper or case.truth
    return [
        Row(case.label, case.title, f"d {case.outcome}/d {wrt}", case.truth[k], upper[k], _column(ours, k),
            _column(differences, k), _column(softened, k), None if mujoco is None else float(mujoco[k]),
            case.tolerance, case.remark, case.weakness, failures)
        for k, wrt in enumerate(case.names)
    ]  # fmt: skip


def _column(held: dict[str, Array], k: int) -> dict[str, float]:
    return {name: float(x[k]) for name, x in held.items()}


def bundles(labels: Sequence[str], sizes: Sequence[int], repeats: int, seed: int) -> list[Bundle]:
    """First and zeroth order across the jumps with these labels, all with one random stream."""
    rng = np.random.default_rng(seed)
    out = []
    for jump in (jump for jump in jumps.jumps(Exact()) if jump.label in labels):
        for size in sizes:
            runs = [jump.estimates(size, rng) for _ in range(repeats)]
            for order in runs[0]:
                means = np.array([r[order].mean[0] for r in runs])
                rms = float(np.sqrt(((means - jump.truth) ** 2).mean()))
                reported = float(np.median([r[order].standard_error for r in runs]))
                variance = float(np.mean([r[order].total_variance for r in runs]))
                mean = float(means.mean())
                out.append(Bundle(jump.label, jump.title, order, size, jump.truth, mean, rms, reported, variance))
    return out
