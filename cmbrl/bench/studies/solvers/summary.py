"""What the cells of all problems say: who solved what, how fast, and who failed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cmbrl.bench.studies.solvers.bank import INFEASIBLE
from cmbrl.bench.studies.solvers.measure import Cell
from cmbrl.bench.studies.solvers.problems import FAMILIES
from cmbrl.bench.study import Table

LEVELS = (1e-4, 1e-8)  #: "solved" means below this on the exact law


@dataclass(frozen=True)
class Summary:
    """Cells of feasible problems, in order of solver and family; ``families``: name -> its problems."""

    cells: list[Cell]
    solvers: list[str]
    laws: dict[str, str]
    families: dict[str, list[str]]

    @classmethod
    def of(cls, cells: Iterable[Cell]) -> Summary:
        """Leaves the infeasible problem out: nobody can solve it."""
        kept = [c for c in cells if not c.problem.endswith(INFEASIBLE)]
        found: dict[str, list[str]] = {}
        for name in dict.fromkeys(c.problem for c in kept):
            found.setdefault(name.split("/")[0], []).append(name)
        known = [f for f in FAMILIES if f in found]
        families = {f: found[f] for f in [*known, *(f for f in found if f not in known)]}
        laws = {c.solver: c.law for c in kept}
        return cls(kept, list(laws), laws, families)

    def of_solver(self, solver: str, problems: Iterable[str] | None = None) -> list[Cell]:
        """Cells of one solver, on some problems or on all."""
        among = None if problems is None else set(problems)
        return [c for c in self.cells if c.solver == solver and (among is None or c.problem in among)]

    def times(
        self, solver: str, level: float, problems: Iterable[str] | None = None, measure: str = "exact"
    ) -> dict[str, float]:
        """Problem -> seconds of the cheapest setting whose score ``measure`` is below ``level``, where one is."""
        best: dict[str, float] = {}
        for c in self.of_solver(solver, problems):
            if getattr(c.score, measure) <= level:
                best[c.problem] = min(c.seconds, best.get(c.problem, np.inf))
        return best

    def curve(self, solver: str, problems: list[str], measure: str = "exact") -> tuple[np.ndarray, np.ndarray]:
        """Median microseconds and 90th percentile of a score over ``problems``, by falling tolerance, (k,) each."""
        cells = self.of_solver(solver, problems)
        tolerances = sorted({c.tolerance for c in cells}, reverse=True)
        at = [[c for c in cells if c.tolerance == e] for e in tolerances]
        time = [1e6 * float(np.median([c.seconds for c in group])) for group in at]
        worth = [float(np.quantile([getattr(c.score, measure) for c in group], 0.9, method="higher")) for group in at]
        return np.array(time), np.array(worth)

    def tables(self) -> list[Table]:
        """Solved problems and time by family, at both levels; the relaxed law's own scores."""
        return [*(self._solved(level) for level in LEVELS), self._worst(), self._relaxed()]

    def _solved(self, level: float) -> Table:
        rows: list[list[str | float | int | None]] = []
        for solver in self.solvers:
            row: list[str | float | int | None] = [solver, self.laws[solver]]
            total = 0
            for problems in self.families.values():
                times = self.times(solver, level, problems)
                total += len(times)
                row += [
                    f"{len(times)}/{len(problems)}",
                    1e6 * float(np.median(list(times.values()))) if times else None,
                ]
            rows.append([*row, sum(map(len, self.families.values())) - total])
        columns = [x for family in self.families for x in (family, "us")]
        return Table(
            f"Solved below {level:g} on the exact law", ["solver", "law aimed at", *columns, "failed in all"], rows,
            "Problems of each family solved (by the cheapest tolerance that does) and their median microseconds. "
            "Solvers of the convex relaxation are scored on the exact law here.",
        )  # fmt: skip

    def _worst(self) -> Table:
        rows = []
        for solver in self.solvers:
            tightest = min(c.tolerance for c in self.of_solver(solver))
            rows.append([solver, self.laws[solver]] + [
                max(c.score.exact for c in self.of_solver(solver, problems) if c.tolerance == tightest)
                for problems in self.families.values()
            ])  # fmt: skip
        return Table(
            "Worst residual at the tightest tolerance, exact law", ["solver", "law aimed at", *self.families], rows,
            "Largest of natural map, momentum balance and penetration over the problems of a family.",
        )  # fmt: skip

    def _relaxed(self) -> Table:
        rows = []
        for solver in (s for s in self.solvers if self.laws[s] == "convex"):
            cells = self.of_solver(solver)
            tightest = [c for c in cells if c.tolerance == min(c.tolerance for c in cells)]
            values = [[getattr(c.score, part) for c in tightest] for part in ("power", "relaxed", "dynamics")]
            rows.append(
                [solver, *(f(x) for x in values for f in (_median, max)), 1e6 * _median([c.seconds for c in tightest])]
            )
        columns = [
            f"{part}, {how}" for part in ("|<impulse, c>|", "natural map", "dynamics") for how in ("median", "worst")
        ]
        return Table(
            "The convex relaxation on its own law, tightest tolerance", ["solver", *columns, "us, median"], rows,
            "Natural map of the relaxation with round cones: friction pyramids in space miss it by their corners, and "
            "are judged by |<impulse, c>|.",
        )  # fmt: skip


def _median(values: list[float]) -> float:
    return float(np.median(values))
