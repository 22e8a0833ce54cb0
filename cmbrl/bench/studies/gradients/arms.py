"""The estimators that are compared, by family and smoothing length. Rollouts are hard unless the family says "both"."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.bench.studies.gradients.systems import System
from cmbrl.contact import Barrier, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.gradients import Estimate, RandomisedModel, pathwise, zeroth_order_bundle
from cmbrl.models.protocol import failures

LENGTHS = (1e-5, 1e-4, 1e-3, 1e-2)  #: smoothing lengths [m]
FAMILIES = {
    "exact": "pathwise, hard (plain FOPG)",
    "barrier": "pathwise, constant kappa in the derivative (BS)",
    "gaussian": "pathwise, kappa by distance in the derivative (our Gaussian schedule)",
    "barrier, both": "pathwise, constant kappa in simulation and derivative",
    "gaussian, both": "pathwise, kappa by distance in simulation and derivative",
    "randomised": "pathwise, bundle of Jacobians in every step",
    "zeroth order": "zeroth order over policy parameters",
}  #: names in legends, in their order


@dataclass(frozen=True)
class Arm:
    """One estimator. ``length``: smoothing length [m]; of zeroth order, the deviation of the parameters. ``bundle``:
    size of a bundle."""

    family: str
    length: float | None = None
    bundle: int | None = None

    @property
    def name(self) -> str:
        """As in tables."""
        size = f", {self.bundle} samples" if self.bundle else ""
        return self.family if self.length is None else f"{self.family} {self.length:g}{size}"

    def kappa(self, system: System) -> float | None:
        """Of a constant schedule [J]."""
        if not self.family.startswith("barrier"):
            return None
        return float(Barrier(length=self.length).resolve(system.scene, system.settings["time_step"])["kappa"])

    def estimate(self, system: System, horizon: int, samples: int, seed: int) -> tuple[Estimate, int]:
        """From ``samples`` initial states, and the number of solves that failed."""
        model = system.model()
        if self.length is not None and self.family in ("barrier", "gaussian"):
            model = system.model(backward_smoothing=_smoothing(self.family, self.length))
        elif self.length is not None and self.family.endswith("both"):
            model = system.model(smoothing=_smoothing(self.family.split(",")[0], self.length))
        if self.family == "randomised" and self.bundle and self.length:
            bundle = RandomisedModel(model, self.bundle, position=self.length, seed=seed)
            objective = system.rollout(bundle, horizon, samples, seed, scale=1 + self.bundle)
            return pathwise(objective, system.at, samples), bundle.failures
        objective = system.rollout(model, horizon, samples, seed)
        if self.family == "zeroth order" and self.length is not None:
            rng = np.random.default_rng(seed + 1)
            return zeroth_order_bundle(objective, system.at, self.length, samples, rng), failures(model) or 0
        return pathwise(objective, system.at, samples), failures(model) or 0


def arms(lengths: Sequence[float] = LENGTHS, bundles: Sequence[int] = (4, 16)) -> Iterator[Arm]:
    """Every family at every length; bundles of the largest size, and of all sizes at the last length but one."""
    yield Arm("exact")
    for family in ("barrier", "gaussian", "barrier, both", "gaussian, both"):
        for length in lengths:
            yield Arm(family, length)
    for length in lengths[1:]:
        yield Arm("randomised", length, bundles[-1])
    for bundle in bundles[:-1]:
        yield Arm("randomised", lengths[-2], bundle)
    for deviation in (1e-3, 1e-2, 1e-1):
        yield Arm("zeroth order", deviation)


def _smoothing(family: str, length: float) -> Smoothing:
    return Barrier(length=length) if family == "barrier" else Gaussian(length=length)
