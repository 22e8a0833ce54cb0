"""Every solver on one problem over a sweep of tolerances: the time of a solve and the residuals of its answer.

Only the solve is timed. Laying out arrays for a solver's interface comes before, reading its answer after. Work that
the interface does in the call (checks, copies, factorising M, set-up) counts. Solvers take turns on each problem, so
that a slow minute affects all alike. Times are processor time of the process, so that a solver's threads count.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from cmbrl.bench.timing import interleaved
from cmbrl.contact.certificates import project, residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers import Solution, Solver, get
from cmbrl.contact.solvers.protocol import Finish, Run

TOLERANCES, QUICK_TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12), (1e-4, 1e-8, 1e-12)
REPEATS, QUICK_REPEATS = 5, 2
OPTIONS = {"pgs": {"sweeps": 5000}}  #: as many as the ADMM solvers have iterations
SHORT = 1e-3  # [s] of work in one clock reading, so that other solvers' data have left the caches
BUDGET = 1.0  # [s] for one solve
LONG = 2e-2  # [s] solves that take longer are timed once, by the solve that is scored


@dataclass(frozen=True)
class Score:
    """Residuals of an answer, in the units of :mod:`cmbrl.contact.certificates`; infinite unless all is finite.

    The first three are of the exact law. ``relaxed``: natural map of the convex relaxation (K_mu contains lambda,
    perpendicular to c, in the dual cone). ``power``: |<lambda, c>|, which the relaxation makes zero for cones and
    pyramids alike.
    """

    natural_map: float = np.inf
    dynamics: float = np.inf
    penetration: float = np.inf
    relaxed: float = np.inf
    power: float = np.inf

    @property
    def convex(self) -> float:
        """What a solver of the relaxation makes zero with any cone: power, dynamics, penetration."""
        return max(self.power, self.dynamics, self.penetration)

    @property
    def exact(self) -> float:
        """The largest of the first three. The natural map alone overlooks the speed of a light body under a heavy one,
        and a v' that its impulses do not produce."""
        return max(self.natural_map, self.dynamics, self.penetration)


def score(problem: ContactProblem, solution: Solution) -> Score:
    """Scores an answer on the exact law and on the convex relaxation."""
    if not (np.isfinite(solution.v).all() and np.isfinite(solution.impulse).all()):
        return Score()
    exact = residuals(problem, solution.v, solution.impulse)
    c = problem.J @ solution.v + problem.b + problem.R * solution.impulse
    force = max(float(np.linalg.norm(problem.M @ problem.v_free)), 1e-300) / len(problem.mu)
    diagonal = np.diag(problem.delassus()).reshape(c.shape) + problem.R
    step = 1 / np.maximum(diagonal.max(axis=1, keepdims=True), 1e-300)
    moved = solution.impulse - project(solution.impulse - step * c, problem.mu)
    power = abs(float((solution.impulse * c).sum())) / (force * problem.speed)
    return Score(
        exact.natural_map, exact.dynamics, exact.penetration, float(np.linalg.norm(moved)) / force, power
    )  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One solver on one problem at one tolerance. ``seconds``: of one solve, median of the turns."""

    problem: str
    solver: str
    law: str
    tolerance: float
    seconds: float
    iterations: int | None
    ok: bool
    score: Score

    @classmethod
    def of(cls, held: Mapping[str, Any]) -> Cell:
        """From JSON, where infinity is a word."""
        return cls(**{**held, "score": Score(**{name: float(x) for name, x in held["score"].items()})})


def measure(problem: ContactProblem, solvers: Sequence[str], tolerances: Sequence[float], repeats: int) -> list[Cell]:
    """Cells of all ``solvers`` at all ``tolerances``, which fall. The answer of a solver that exceeds its budget also
    stands for tighter tolerances."""
    chosen = [get(name, **OPTIONS.get(name, {})) for name in solvers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of solvers about failures that the scores show
        return _sweep(problem, chosen, tolerances, repeats)


def _sweep(problem: ContactProblem, solvers: Sequence[Solver], tolerances: Sequence[float], repeats: int) -> list[Cell]:
    runs = {solver.name: _prepared(solver, problem) for solver in solvers}
    cells: list[Cell] = []
    spent: dict[str, Cell] = {}
    for tolerance in tolerances:
        first = {name: _timed(run, tolerance) for name, run in runs.items() if name not in spent}
        work = {
            name: (_repeated(runs[name], tolerance, units), units)
            for name, (seconds, _) in first.items()
            if seconds < LONG and (units := max(1, round(SHORT / seconds)))
        }
        turns = interleaved(work, repeats, clock=time.process_time) if work else {}
        for solver in solvers:
            if solver.name in spent:
                cells.append(replace(spent[solver.name], tolerance=tolerance))
                continue
            seconds, found = first[solver.name]
            if solver.name in turns:
                seconds = float(np.median(turns[solver.name]))
            worth = score(problem, found)
            cells.append(
                Cell(problem.name, solver.name, solver.law, tolerance, seconds, found.iterations, bool(found.ok), worth)
            )
            if seconds > BUDGET:
                spent[solver.name] = cells[-1]
    return cells


def _prepared(solver: Solver, problem: ContactProblem) -> Run:
    """``run`` that never raises: a solver that raises an exception has failed on the problem."""
    try:
        run = solver.prepare(problem)
    except Exception:
        return lambda tolerance: partial(Solution.failed, problem)

    def guarded(tolerance: float) -> Finish:
        try:
            return run(tolerance)
        except Exception:
            return partial(Solution.failed, problem)

    return guarded


def _timed(run: Run, tolerance: float) -> tuple[float, Solution]:
    """Runs once, and a second time after a short run, since a first call finds cold caches."""
    seconds = 0.0
    for _ in range(2):
        begin = time.process_time()
        finish = run(tolerance)
        seconds = max(time.process_time() - begin, 1e-7)
        if seconds > LONG:
            break
    return seconds, finish()


def _repeated(run: Run, tolerance: float, units: int) -> Callable[[], None]:
    def work() -> None:
        for _ in range(units):
            run(tolerance)

    return work
