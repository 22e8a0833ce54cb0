"""Adaptive random search: most candidates near the best so far, some far; widths follow the steps that succeed.

A candidate depends on (seed, search, round, index) only: its numbers come from a counter-based generator (Philox,
Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011), so the number of threads does not matter. Spall,
"Introduction to Stochastic Search and Optimization", chapter 2, surveys such methods; the adaptation of the widths is
our choice.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.state import Journal

_FIRST_WIDTH = 0.6  # prior standard deviations
_WIDTH_RANGE = (1e-3, 1.5)
_FAR_EVERY, _FAR_WIDTH = 8, 1.5  # one candidate in eight comes from the widened prior, to leave a wrong valley
_SHRINK, _FOLLOW = 0.8, 2.0
_DECADES = 1.5  # the length of a step is log-uniform over this many decades below its width


@dataclass(frozen=True)
class Search:
    """Result of a search: the best z (n,), its objective and the number of candidates.

    ``course``: how many candidates had been tried, and the best objective then, from time to time.
    """

    z: np.ndarray
    value: float
    candidates: int
    course: tuple[tuple[int, float], ...] = ()


Keep = Callable[[np.ndarray], None]  # receives every new best z, so that an interrupted search is not lost


def forget(z: np.ndarray) -> None:
    """A Keep that keeps nothing."""


def random_search(
    objective: Objective,
    start: np.ndarray,
    seed: int,
    rounds: int,
    population: int,
    journal: Journal,
    name: str,
    keep: Keep = forget,
) -> Search:
    """Minimises ``objective`` from ``start`` (n,) with ``rounds`` batches of ``population`` candidates.

    Raises the journal's OutOfTime between batches.
    """
    moving = np.flatnonzero(objective.active)
    best, value = objective.clip(start), np.inf
    width = np.full(len(moving), _FIRST_WIDTH)
    course = []
    for index in range(rounds):
        z = propose(objective, best, moving, width, seed, name, index, population)
        if index == 0:
            z[0] = best
        values = journal.losses(name, index, partial(objective.values, z))
        winner = int(values.argmin())
        if values[winner] < value:
            step = np.abs(z[winner] - best)[moving]
            best, value = z[winner], float(values[winner])
            keep(best)
            width = np.where(step > 0.0, np.maximum(_FOLLOW * step, _SHRINK * width), width)
        else:
            width = _SHRINK * width
        width = np.clip(width, *_WIDTH_RANGE)
        course.append(((index + 1) * population, value))
    return Search(best, value, rounds * population, tuple(course))


def propose(
    objective: Objective,
    centre: np.ndarray,
    moving: np.ndarray,
    width: np.ndarray,
    seed: int,
    name: str,
    index: int,
    population: int,
) -> np.ndarray:
    """Candidates (population, n) of round ``index`` of the search ``name``, inside the bounds."""
    z = np.repeat(centre[None], population, axis=0)
    key = [seed & 0xFFFFFFFFFFFFFFFF, zlib.crc32(name.encode())]
    share = max(0.3, min(1.0, 2.0 / max(len(moving), 1)))  # of the parameters that a candidate moves
    for i in range(population):
        draw = np.random.Generator(np.random.Philox(key=key, counter=[0, 0, i, index]))
        chosen = draw.random(len(moving)) < share
        chosen[draw.integers(len(moving))] = True
        normal = draw.standard_normal(len(moving))
        if i % _FAR_EVERY == _FAR_EVERY - 1:
            z[i, moving] = np.where(chosen, _FAR_WIDTH * normal, centre[moving])
        else:
            length = width * 10.0 ** (-_DECADES * draw.random())
            z[i, moving] += np.where(chosen, length * normal, 0.0)
    return objective.clip(z)
