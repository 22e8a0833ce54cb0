"""Levenberg-Marquardt on the Huberised residuals with the Gaussian prior, inside the bounds.

Each iteration solves ``(H + lambda diag H) dz = -g`` with H = J^T W J + s I from the implicit derivatives of the step
and the Huber weights W, for one lambda after the other, two at a time, until J rises again; the best is kept
(Marquardt, J. SIAM 11, 1963; iteratively reweighted: Holland and Welsch, 1977). Near the end the first two tell.

Where contacts make a window chaotic, only very short steps along the equations may lower J: one iteration without an
episode has to forget that episode, or what is held out has been seen.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import NOT_FINITE, SOLVER_VARIANCE, NotFinite, Objective
from cmbrl.fitting.search.random_search import Keep, Search, forget
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal

_BATCHES = 10.0 ** np.arange(-1.0, 11.0).reshape(6, 2)  # multiples of lambda
_LAMBDA_RANGE = (1e-8, 1e8)
_PASS_DECREASE, _FALLS = 1e-3, 0.7  # of an iteration; times the loss of the pass before
_LIGHTER = 0.01  # times the weight of a heavy prior in the pass before
_DECREASE = 1e-4  # relative; a smaller decrease ends the search if damping is small, or the second time


def gauss_newton(
    objective: Objective,
    start: np.ndarray,
    iterations: int,
    journal: Journal,
    keep: Keep = forget,
    decrease: float = _DECREASE,
) -> Search:
    """Minimises ``objective`` from ``start`` (n,), until an iteration lowers it by a share ``decrease`` or less.

    Raises the journal's OutOfTime between iterations, and NotFinite where all windows diverge or equations overflow.
    """
    if objective.remaining == np.inf and objective.variance > 0.0:
        raise NotFinite(NOT_FINITE)
    z = objective.clip(start)
    value = float(objective.values(z[None])[0])
    damping, idle, candidates = 1e-3, 0, 1
    course = [(1, value)]
    search = [*z.tolist(), value, objective.strength]
    for index in range(iterations):
        told = journal.step(search, index, partial(_lower, objective, z, value, damping))
        candidates += int(told[0])
        if len(told) == 1:
            break
        lowest, step, z, offset = float(told[1]), float(told[2]), told[3 : 3 + len(z)], told[3 + len(z) :]
        fall, value = value - lowest, lowest
        if len(offset):
            objective = objective.starting(offset.reshape(len(objective.loss.windows.starts), -1))
        begun = objective.begun(z)
        if begun is not objective and (lower := float(begun.values(z[None])[0])) < value:
            objective, value = begun, lower
        keep(z)
        damping = float(np.clip(step, *_LAMBDA_RANGE))
        course.append((candidates, value))
        idle = idle + 1 if fall <= decrease * value else 0
        if idle == 2 or (idle == 1 and damping < 1.0):
            break
    return Search(z, value, candidates, tuple(course))


def reweighed(
    loss: PredictionLoss,
    space: Space,
    active: np.ndarray,
    start: np.ndarray,
    iterations: int,
    journal: Journal,
    heavy: float = 0.0,
    passes: int = 1,
    usual: float | None = None,
) -> np.ndarray:
    """Where (n,) passes of ``iterations`` lead from ``start`` (n,), each with the prior weighed by what errors remain.

    Errors of the file weigh it far too much for a log that is nearly explained. There are at most so many ``passes``;
    they end where the loss hardly falls, or the solver's accuracy explains it. ``heavy``: variance that weighs the
    prior at first, then less and less: what the log tells best moves first. ``usual``: share of the windows that each
    pass takes for the usual ones (``tolerant`` of the loss); None for the plain loss.
    """
    z, before = start, np.inf
    for _ in range(passes):
        own = loss if usual is None else loss.tolerant(space.theta(z), usual)
        objective = Objective.at(own, space, active, z, heavy)
        if objective.variance > heavy:  # the prior is as light as the errors make it
            if not objective.remaining < _FALLS * before:
                break
            before = objective.remaining
        z = gauss_newton(objective, z, iterations, journal, decrease=_PASS_DECREASE).z
        if objective.variance <= SOLVER_VARIANCE:  # no pass weighs the prior less
            break
        heavy *= _LIGHTER
    return z


def _lower(objective: Objective, z: np.ndarray, value: float, damping: float) -> np.ndarray:
    """How many points were tried; where one has a lower value than that of ``z`` (n,): that, its damping, the point.

    Then where windows start, if they move, all in one row of numbers, which a journal can hold.
    """
    equations = objective.normal_equations(z)
    best, lowest, step, offset, tried = z, value, damping, np.empty(0), 0
    for multiples in _BATCHES:
        steps = damping * multiples
        system = (objective.space, objective.active, z, equations.gradient, equations.hessian)
        points = np.stack([damped_step(*system, x) for x in steps])
        if not np.isfinite(points).all():
            raise NotFinite(NOT_FINITE)
        offsets = objective.followed(equations, points - z)
        values = objective.values(points, offsets, lowest)
        tried += len(points)
        winner = int(values.argmin())
        rises = not (values[winner] < lowest and winner == len(points) - 1)
        if values[winner] < lowest:
            best, lowest, step = points[winner], float(values[winner]), steps[winner]
            offset = offset if offsets is None else offsets[winner].ravel()
        if lowest < value and rises:
            break
    return np.array([tried, lowest, step, *best, *offset] if lowest < value else [tried])


def damped_step(
    space: Space, active: np.ndarray, z: np.ndarray, gradient: np.ndarray, hessian: np.ndarray, damping: float
) -> np.ndarray:
    """The damped step from ``z`` over ``active``. Parameters that reach a bound stay there; the others adjust."""
    low, high = space.z_low, space.z_high
    free = active & ~((z <= low) & (gradient > 0.0)) & ~((z >= high) & (gradient < 0.0))
    point = z.copy()
    while free.any():
        inner = hessian[np.ix_(free, free)]
        system = inner + damping * np.diag(np.diag(inner))
        held = np.where(free, 0.0, point - z)  # steps of the parameters on their bounds
        right = -(gradient + hessian @ held)[free]
        point[free] = z[free] + np.linalg.solve(system, right)
        beyond = free & ((point < low) | (point > high))
        if not beyond.any():
            break
        point = np.where(beyond, np.clip(point, low, high), point)
        free &= ~beyond
    return point
