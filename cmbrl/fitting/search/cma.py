"""CMA-ES as an alternative to the random search (package cmaes; Hansen, arXiv 1604.00772)."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec

import numpy as np

from cmbrl.errors import UserError
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.random_search import Keep, Search, forget
from cmbrl.fitting.state import Journal

_FIRST_WIDTH = 0.5  # prior standard deviations


def cma_search(
    objective: Objective,
    start: np.ndarray,
    seed: int,
    rounds: int,
    population: int,
    journal: Journal,
    name: str,
    keep: Keep = forget,
) -> Search:
    """Minimises ``objective`` from ``start`` (n,) with ``rounds`` generations of ``population`` candidates.

    Raises the journal's OutOfTime between generations.
    """
    from cmaes import CMA

    moving = np.flatnonzero(objective.active)
    best = objective.clip(start)
    value = float(journal.losses(f"{name}/start", 0, lambda: objective.values(best[None]))[0])
    if len(moving) == 1:  # the library needs two dimensions: add one without effect
        moving = np.append(moving, -1)
    inside = moving[moving >= 0]
    strategy = CMA(
        mean=np.where(moving >= 0, best[moving], 0.0),
        sigma=_FIRST_WIDTH,
        bounds=np.stack(
            [_bound(objective.space.z_low, moving, -1.0), _bound(objective.space.z_high, moving, 1.0)], axis=1
        ),
        seed=seed % 2**32,
        population_size=population,
    )
    course = [(1, value)]
    for index in range(rounds):
        asked = [strategy.ask() for _ in range(population)]
        z = np.repeat(best[None], population, axis=0)
        z[:, inside] = np.array(asked)[:, : len(inside)]
        values = journal.losses(name, index, partial(objective.values, z))
        strategy.tell([(x, float(f)) for x, f in zip(asked, values, strict=True)])
        winner = int(values.argmin())
        if values[winner] < value:
            best, value = z[winner], float(values[winner])
            keep(best)
        course.append(((index + 1) * population, value))
    return Search(best, value, rounds * population, tuple(course))


def require_library() -> None:
    """Raises UserError if the library is missing."""
    if find_spec("cmaes") is None:
        raise UserError("method 'cma' needs the package cmaes: pip install 'cmbrl[fit]'")


def _bound(edge: np.ndarray, moving: np.ndarray, filler: float) -> np.ndarray:
    return np.where(moving >= 0, edge[moving], filler)
