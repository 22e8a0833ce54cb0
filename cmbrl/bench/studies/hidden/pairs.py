"""Returns draw by draw, and what pairs of them tell: differences, wins, share of the way to the oracle, intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.bench.intervals import interval
from cmbrl.bench.studies.hidden.arms import NOMINAL, ORACLE, RANDOMISED
from cmbrl.bench.studies.hidden.judge import Result
from cmbrl.bench.studies.hidden.plan import GAP

Key = tuple[str, str, int, str]  #: scene, family, draw, arm
Returns = dict[int, float]  #: by draw


@dataclass(frozen=True)
class Runs:
    """Every policy in every hidden robot that it was tried on: a list of seeds by scene, family, draw and arm."""

    found: dict[Key, list[Result]]

    @classmethod
    def of(cls, cells: Iterable[Result]) -> Runs:
        """From the results of jobs."""
        found: dict[Key, list[Result]] = {}
        for cell in cells:
            for one in cell.get("tried", [cell]):
                found.setdefault((cell["scene"], one["family"], one["draw"], cell["arm"]), []).append(
                    {**cell, "real": one["real"]}
                )
        return cls(found)

    def arms(self, scene: str, family: str) -> list[str]:
        """Those that were tried, in the order of the jobs."""
        return list(dict.fromkeys(arm for s, f, _, arm in self.found if (s, f) == (scene, family)))

    def returns(self, scene: str, family: str, arm: str) -> Returns:
        """Mean return of an arm by draw, over its seeds; a run without a policy earns 0."""
        own = {key[2]: runs for key, runs in self.found.items() if (key[0], key[1], key[3]) == (scene, family, arm)}
        return {draw: float(np.mean([mean_return(run) for run in own[draw]])) for draw in sorted(own)}

    def falls(self, scene: str, family: str, arm: str) -> float:
        """Share of episodes with a fall; all of a run without a policy."""
        runs = [run for (s, f, _, a), own in self.found.items() if (s, f, a) == (scene, family, arm) for run in own]
        return float(np.mean([share_of_falls(run) for run in runs]))

    def rival(self, scene: str, family: str) -> str | None:
        """The width of randomisation that earns most over the draws of a family."""
        widths = [arm for arm in self.arms(scene, family) if arm.startswith(RANDOMISED)]
        return max(widths, key=lambda arm: np.mean([*self.returns(scene, family, arm).values()]), default=None)

    def way(self, scene: str, family: str, arm: str) -> Way:
        """How far an arm comes from nominal to oracle."""
        start, goal = (self.returns(scene, family, name) for name in (NOMINAL, ORACLE))
        return Way.of(start, self.returns(scene, family, arm), goal)


def mean_return(run: Result) -> float:
    """Of a policy in a hidden robot."""
    returns = [x for x in (run["real"] or {}).get("returns", ()) if x is not None]
    return float(np.mean(returns)) if returns else 0.0


def share_of_falls(run: Result) -> float:
    """Of a policy in a hidden robot."""
    return float(np.mean(run["real"]["falls"])) if run["real"] else 1.0


@dataclass(frozen=True)
class Difference:
    """One arm less another over the draws that both have: mean with its 95 % interval, ``wins`` of ``count``."""

    mean: float
    low: float
    high: float
    wins: int
    count: int

    @classmethod
    def of(cls, one: Returns, other: Returns) -> Difference | None:
        """None without a common draw."""
        gains = np.array([one[draw] - other[draw] for draw in one if draw in other])
        if not len(gains):
            return None
        low, high = interval(lambda rows: gains[rows].mean(axis=-1), len(gains))
        return cls(float(gains.mean()), low, high, int((gains > 0).sum()), len(gains))


@dataclass(frozen=True)
class Way:
    """Share of the way from nominal (0) to oracle (1).

    median: over the ``counted`` draws where oracle and nominal are apart; ``ratio``: of the mean gains of all
    ``count`` draws, with its 95 % interval. None where nothing is to be said.
    """

    median: float | None
    counted: int
    count: int
    ratio: float | None
    low: float | None
    high: float | None

    @classmethod
    def of(cls, start: Returns, arm: Returns, goal: Returns) -> Way:
        """Of the draws that all three have."""
        draws = [draw for draw in arm if draw in start and draw in goal]
        a, x, b = (np.array([found[draw] for draw in draws]) for found in (start, arm, goal))
        apart = b - a > GAP * np.maximum(np.abs(a), np.abs(b))
        shares = (x[apart] - a[apart]) / (b[apart] - a[apart])
        median = float(np.median(shares)) if len(shares) else None
        if not len(draws) or b.mean() - a.mean() <= GAP * max(abs(a.mean()), abs(b.mean())):
            return cls(median, len(shares), len(draws), None, None, None)
        low, high = interval(lambda k: _ratio(x[k] - a[k], b[k] - a[k]), len(draws))
        return cls(median, len(shares), len(draws), float(_ratio(x - a, b - a)), low, high)


def _ratio(gain: np.ndarray, most: np.ndarray) -> Any:
    with np.errstate(divide="ignore", invalid="ignore"):  # of a resample in which all draws are the same
        return gain.sum(axis=-1) / most.sum(axis=-1)


def spread(runs: Sequence[Result]) -> float | None:
    """Standard deviation of the mean returns of several seeds; None of one."""
    return float(np.std([mean_return(run) for run in runs], ddof=1)) if len(runs) > 1 else None
