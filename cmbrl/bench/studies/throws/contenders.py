"""The estimators that look for a launch velocity: what they smooth, with what, and their colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cmbrl.contact.smoothing import Adaptive, Barrier, Exact, Smoothing
from cmbrl.gradients.aobg import aobg
from cmbrl.gradients.estimate import Array, Estimate, Objective
from cmbrl.gradients.estimators import first_order_bundle, pathwise, zeroth_order_bundle

POINT, BUNDLE, ZEROTH, MIXED = "point", "bundle", "zeroth", "mixed"
THROWS = {POINT: 1, BUNDLE: 1, ZEROTH: 2, MIXED: 3}  #: that one sample takes


HARD = Exact()


@dataclass(frozen=True)
class Contender:
    """``smoothing`` is of the derivative alone; ``order``: at the decision itself, or over noise on it, and how."""

    summary: str
    family: str
    colour: str
    order: str
    smoothing: Smoothing = HARD

    def estimates(
        self, objective: Callable[[int], Objective], x: Array, throws: int, std: float, rng: np.random.Generator
    ) -> list[Estimate]:
        """One gradient for each of the decisions x (R, n), of ``throws`` throws each.

        ``objective(count)`` is that of ``count`` fresh samples for each decision, in the order of the decisions.
        """
        samples = throws // THROWS[self.order]
        points, rows = np.repeat(x, samples, axis=0), samples * len(x)

        def fresh() -> Objective:
            return objective(samples)

        if self.order == POINT:
            return _split(pathwise(fresh(), points, rows), len(x))
        if self.order == BUNDLE:
            return _split(first_order_bundle(fresh(), points, std, rows, rng), len(x))
        zeroth = _split(zeroth_order_bundle(fresh(), points, std, rows, rng), len(x))
        if self.order == ZEROTH:
            return zeroth
        first = _split(first_order_bundle(fresh(), points, std, rows, rng), len(x))
        return [aobg(one, other)[0] for one, other in zip(first, zeroth, strict=True)]


def _split(estimate: Estimate, runs: int) -> list[Estimate]:
    """Of all decisions -> of each."""
    return [
        Estimate(part, estimate.steps // runs, estimate.derivative_steps // runs)
        for part in np.split(estimate.gradients, runs)
    ]


ABS, BS, FIRST, SAMPLED = "adaptive (ABS)", "barrier (BS)", "first order, hard", "zeroth order and mixed"
FAMILIES = (ABS, BS, FIRST, SAMPLED)
CONTENDERS = {
    "ABS 1 mm": Contender("kappa by distance in the derivative, over 1 mm", ABS, "#fcae91", BUNDLE, Adaptive(1e-3)),
    "ABS 1 cm": Contender("the same, 1 cm", ABS, "#fb6a4a", BUNDLE, Adaptive(1e-2)),
    "ABS 3 cm": Contender("the same, 3 cm", ABS, "#cb181d", BUNDLE, Adaptive(3e-2)),
    "ABS 10 cm": Contender("the same, 10 cm", ABS, "#67000d", BUNDLE, Adaptive(1e-1)),
    "BS 1e-4 J": Contender("constant kappa in the derivative", BS, "#9ecae1", BUNDLE, Barrier(1e-4)),
    "BS 1e-2 J": Contender("the same, 1e-2 J", BS, "#4292c6", BUNDLE, Barrier(1e-2)),
    "BS 1 J": Contender("the same, 1 J", BS, "#08306b", BUNDLE, Barrier(1.0)),
    "FOPG": Contender("the hard derivative, without noise on the decision", FIRST, "black", POINT),
    "bundle": Contender("hard derivatives over the noise: the first-order bundle", FIRST, "#e6ab02", BUNDLE),
    "ZOPG": Contender("zeroth order: values only, antithetic noise", SAMPLED, "#a6761d", ZEROTH),
    "AoBG": Contender("first- and zeroth-order bundle by inverse variance", SAMPLED, "#7570b3", MIXED),
}  #: by name, in the order of tables and legends


def of_family(family: str, names: tuple[str, ...]) -> list[str]:
    """Those of ``names`` that belong to ``family``."""
    return [name for name in names if CONTENDERS[name].family == family]
