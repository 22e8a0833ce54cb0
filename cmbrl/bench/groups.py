"""Gradients at several points in one batch, by first order, zeroth order or both."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cmbrl.gradients import aobg
from cmbrl.gradients.estimate import Array, Estimate, Objective
from cmbrl.gradients.estimators import first_order_bundle, pathwise, zeroth_order_bundle

POINT, FIRST, ZEROTH = "point", "first", "zeroth"  #: at the point itself; over noise on it: derivatives, values


def estimates(
    orders: Sequence[str],
    objective: Callable[[str], Objective],
    x: Array,
    samples: int,
    std: float,
    rng: np.random.Generator,
) -> list[Estimate]:
    """One estimate for each of the points x (R, n), from ``samples`` samples each.

    orders: taken one after the other; first and zeroth together are mixed by inverse variance (AoBG).
    objective: R ``samples`` samples in the order of the points, for the order given. std: deviation of the noise.
    """
    points, rows = np.repeat(x, samples, axis=0), samples * len(x)
    found = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for order in orders:
            if order == POINT:
                found[order] = _split(pathwise(objective(order), points, rows), len(x))
            else:
                bundle = {FIRST: first_order_bundle, ZEROTH: zeroth_order_bundle}[order]
                found[order] = _split(bundle(objective(order), points, std, rows, rng), len(x))
        if len(orders) == 1:
            return found[orders[0]]
        return [aobg(first, zeroth)[0] for first, zeroth in zip(found[FIRST], found[ZEROTH], strict=True)]


def _split(estimate: Estimate, runs: int) -> list[Estimate]:
    parts = np.split(estimate.gradients, runs)
    return [Estimate(part, estimate.steps // runs, estimate.derivative_steps // runs) for part in parts]
