"""Every solver on one problem over a sweep of tolerances: how long the solve takes, what its answer is worth.

Only the solve is timed: laying arrays out for a solver's interface before, and reading its answer after, are not. What
a solver's own interface does in the call (checks, copies, factorising M, setting up) counts. Solvers take turns on each
problem, so that a slow minute of the machine hits all alike; the time is processor time of the process, so that a
solver's own threads count.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from cmbrl.bench.studies.solvers.scores import Score, score
from cmbrl.bench.timing import interleaved
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers.protocol import Finish, Run, Solution, Solver

TOLERANCES, QUICK_TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12), (1e-4, 1e-8, 1e-12)
REPEATS, QUICK_REPEATS = 5, 2
SHORT = 1e-3  # [s] a clock reading covers about this much work, so that other solvers' data are out of the caches
BUDGET = 1.0  # [s] for one solve
LONG = 2e-2  # [s] what takes longer than this is timed once, by the solve that is scored


@dataclass(frozen=True)
class Cell:
    """One solver on one problem at one tolerance. ``seconds``: median of the turns for one solve."""

    problem: str
    solver: str
    law: str
    tolerance: float
    seconds: float
    iterations: int | None
    ok: bool
    score: Score

    def to_json(self) -> dict[str, object]:
        """As plain values; infinity, which JSON does not know, becomes 1e300."""
        out = asdict(self)
        out["score"] = {key: min(value, 1e300) for key, value in out["score"].items()}
        return out

    @classmethod
    def from_json(cls, held: dict) -> Cell:
        return cls(**{**held, "score": Score(**held["score"])})


def measure(
    problem: ContactProblem, solvers: Sequence[Solver], tolerances: Sequence[float], repeats: int
) -> list[Cell]:
    """Cells of all solvers on ``problem`` at all tolerances, which fall. A solver over its budget has had its chance:
    that answer stands for the tighter tolerances too."""
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
        turns: Mapping[str, np.ndarray] = interleaved(work, repeats, clock=time.process_time) if work else {}
        for solver in solvers:
            if solver.name in spent:
                cells.append(replace(spent[solver.name], tolerance=tolerance))
                continue
            seconds, solution = first[solver.name]
            if solver.name in turns:
                seconds = float(np.median(turns[solver.name]))
            cells.append(
                Cell(problem.name, solver.name, solver.law, tolerance, seconds, solution.iterations, bool(solution.ok),
                     score(problem, solution))
            )  # fmt: skip
            if seconds > BUDGET:
                spent[solver.name] = cells[-1]
    return cells


def _prepared(solver: Solver, problem: ContactProblem) -> Callable[[float], Finish]:
    """``run`` that never raises: whatever a back end throws at a problem, it has failed on it."""
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
    """Once, and where that was short once more: a first call finds nothing in the caches."""
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
