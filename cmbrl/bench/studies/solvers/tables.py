"""Who solved what, how fast, and who failed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.bench.studies.solvers.cells import Cell
from cmbrl.bench.studies.solvers.clock import RobotTimes
from cmbrl.bench.studies.solvers.derivatives import Point
from cmbrl.bench.studies.solvers.hard_cases import INFEASIBLE
from cmbrl.bench.studies.solvers.problems import FAMILIES
from cmbrl.bench.study import Cell as Entry
from cmbrl.bench.study import Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.solvers")
LEVELS = (1e-4, 1e-8)  #: "solved" means an error on the exact law below this
LABELS = {
    "ours": "cmbrl", "ours softened": "cmbrl, softened law",
    "pgs": "Gauss-Seidel (Python loop)", "admm": "ADMM (Python loop)",
    "pinocchio admm": "Pinocchio ADMM", "pinocchio pgs": "Pinocchio Gauss-Seidel",
    "desaxce": "DAQP, De Saxcé loop", "desaxce proxsuite": "ProxQP, De Saxcé loop",
    "desaxce clarabel": "Clarabel, De Saxcé loop", "convex": "DAQP, relaxation", "proxsuite": "ProxQP, relaxation",
    "clarabel": "Clarabel, relaxation", "pinocchio admm convex": "Pinocchio ADMM, relaxation",
}  #: names of solvers for readers; others keep the name that ``cmbrl.contact.solvers.get`` takes  # fmt: skip
LAWS = {"exact": "exact", "round": "relaxation, round cones", "pyramid": "relaxation, pyramid"}


@dataclass(frozen=True)
class Summary:
    """Cells of feasible problems, in order of solver and family; ``families``: name -> its problems."""

    cells: list[Cell]
    solvers: list[str]
    laws: dict[str, str]
    families: dict[str, list[str]]

    @classmethod
    def of(cls, cells: Iterable[Cell]) -> Summary:
        """Leaves out the infeasible problem, which nobody can solve."""
        kept = [c for c in cells if not c.problem.endswith(INFEASIBLE)]
        found: dict[str, list[str]] = {}
        for name in dict.fromkeys(c.problem for c in kept):
            found.setdefault(name.split("/")[0], []).append(name)
        known = [f for f in FAMILIES if f in found]
        families = {f: found[f] for f in [*known, *(f for f in found if f not in known)]}
        laws = {c.solver: c.law for c in kept}
        return cls(kept, list(laws), laws, families)

    @property
    def count(self) -> int:
        """Feasible problems."""
        return sum(map(len, self.families.values()))

    def of_solver(self, solver: str, problems: Iterable[str] | None = None) -> list[Cell]:
        """Cells of one solver, on ``problems`` or on all."""
        among = None if problems is None else set(problems)
        return [c for c in self.cells if c.solver == solver and (among is None or c.problem in among)]

    def tightest(self, solver: str, problems: Iterable[str] | None = None) -> list[Cell]:
        """The same at the solver's tightest tolerance."""
        cells = self.of_solver(solver, problems)
        tolerance = min(c.tolerance for c in cells)
        return [c for c in cells if c.tolerance == tolerance]

    def times(self, solver: str, level: float, problems: Iterable[str] | None = None) -> dict[str, float]:
        """Problem -> seconds of the fastest setting whose error on the exact law is below ``level``, if any."""
        best: dict[str, float] = {}
        for c in self.of_solver(solver, problems):
            if c.score.exact <= level:
                best[c.problem] = min(c.seconds, best.get(c.problem, np.inf))
        return best

    def curve(self, solver: str, problems: list[str], measure: str = "exact") -> tuple[np.ndarray, np.ndarray]:
        """Median microseconds and 90th percentile of a score over ``problems``, by falling tolerance, (k,) each."""
        cells = self.of_solver(solver, problems)
        tolerances = sorted({c.tolerance for c in cells}, reverse=True)
        at = [[c for c in cells if c.tolerance == e] for e in tolerances]
        time = [1e6 * _median(c.seconds for c in group) for group in at]
        worth = [float(np.quantile([getattr(c.score, measure) for c in group], 0.9, method="higher")) for group in at]
        return np.array(time), np.array(worth)


def solved(summary: Summary, level: float) -> Table:
    """Problems of each family solved, and the median time."""
    rows: list[list[Entry]] = []
    for solver in summary.solvers:
        row: list[Entry] = [LABELS.get(solver, solver), summary.laws[solver]]
        total = 0
        for problems in summary.families.values():
            times = summary.times(solver, level, problems).values()
            total += len(times)
            row += [f"{len(times)}/{len(problems)}", 1e6 * _median(times) if times else None]
        rows.append([*row, summary.count - total])
    columns = [x for family in summary.families for x in (family, "us")]
    title = f"Solved below {level:g} on the exact law"
    return Table(title, ["solver", "law", *columns, "failed in all"], rows, WORDS("tables.solved"))


def worst(summary: Summary) -> Table:
    """Largest error by family at the tightest tolerance."""
    rows = [
        [LABELS.get(solver, solver), summary.laws[solver]]
        + [max(c.score.exact for c in summary.tightest(solver, problems)) for problems in summary.families.values()]
        for solver in summary.solvers
    ]
    title = "Worst error on the exact law at the tightest tolerance"
    return Table(title, ["solver", "law", *summary.families], rows, WORDS("tables.worst"))


def relaxed(summary: Summary) -> Table:
    """Solvers of the convex relaxation, judged by their own law."""
    rows = []
    for solver in (s for s in summary.solvers if summary.laws[s] == "convex"):
        cells = summary.tightest(solver)
        values = [[getattr(c.score, part) for c in cells] for part in ("power", "relaxed", "dynamics")]
        spent = 1e6 * _median(c.seconds for c in cells)
        rows.append([LABELS.get(solver, solver), *(f(x) for x in values for f in (_median, max)), spent])
    parts = ("|<impulse, c>|", "natural map", "momentum balance")
    columns = [f"{part}, {how}" for part in parts for how in ("median", "worst")]
    title = "The convex relaxation on its own law, tightest tolerance"
    return Table(title, ["solver", *columns, "us, median"], rows, WORDS("tables.relaxed"))


def core_against_core(clocks: Sequence[RobotTimes]) -> Table:
    """Microseconds and ratios."""
    rows = [
        [c.robot, f"{c.solved}/{c.count}", 1e6 * c.call, 1e6 * c.batch, c.daqp and 1e6 * c.daqp,
         c.daqp and c.batch / c.daqp, c.daqp and c.call / c.daqp]
        for c in clocks
    ]  # fmt: skip
    columns = ["problems", "cmbrl: below 1e-10", "cmbrl, one call [us]", "cmbrl, batch [us]", "DAQP, own clock [us]",
               "cmbrl batch / DAQP", "cmbrl call / DAQP"]  # fmt: skip
    return Table("Core against core, one thread", columns, rows, WORDS("tables.core"))


def derivatives(points: Sequence[Point]) -> Table:
    """Each arm at its most exact setting, by scene."""
    rows: list[list[Entry]] = []
    for scene, arm in dict.fromkeys((p.scene, p.arm) for p in points):
        best = min((p for p in points if (p.scene, p.arm) == (scene, arm)), key=lambda p: p.error)
        setting = f"{best.meaning} {best.setting:g}"
        rows.append([scene, arm, LAWS[best.law], setting, 1e6 * best.seconds, best.error, best.model])
    columns = ["scene", "solver", "law", "setting", "us", "error, own law", "own law - exact law"]
    return Table("Derivatives at each solver's most exact setting", columns, rows, WORDS("tables.derivatives"))


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values)))
