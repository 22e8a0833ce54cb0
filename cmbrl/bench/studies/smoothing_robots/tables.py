"""Tables of finished runs, and the sentences that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from cmbrl.bench.intervals import interval
from cmbrl.bench.studies.smoothing.halving import Ranking
from cmbrl.bench.studies.smoothing.plan import CONSTANT, GAUSSIAN, HARD, PUBLISHED, Arm
from cmbrl.bench.studies.smoothing.verdicts import Gain
from cmbrl.bench.studies.smoothing_robots.cells import Outcome
from cmbrl.bench.studies.smoothing_robots.plan import Plan
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words
from cmbrl.gradients.estimate import Array

WORDS = Words("cmbrl.bench.studies.smoothing_robots")
UPDATES, SECONDS = "updates", "seconds"
PAIRS = ((PUBLISHED, CONSTANT), (PUBLISHED, HARD), (PUBLISHED, GAUSSIAN), (CONSTANT, HARD))  #: the first two are asked
ASKED = PAIRS[:2]
Judged = dict[tuple[str, str], Mapping[str, Outcome]]  #: by what is equal and scene: a run of every family


def returns(cell: Outcome) -> Array:
    """Last returns (seeds,); one that is not finite counts as the least finite one of all."""
    last = np.array(cell["returns"], dtype=float)[-1]
    return np.where(np.isfinite(last), last, np.nanmin(np.array(cell["returns"], dtype=float)))


def score(cell: Outcome) -> tuple[float]:
    """Mean last return of all seeds."""
    return (float(returns(cell).mean()),)


def gain(first: Outcome, second: Outcome) -> Gain:
    """As a share of the mean return of the better one; none where neither earns anything."""
    a, b = returns(first), returns(second)
    best = max(a.mean(), b.mean())
    return Gain.of((a - b) / best if best > 0 else np.zeros(len(a)))


def verdicts_table(judged: Judged) -> Table:
    """A row for each scene, budget and pair."""
    rows: list[list[Cell]] = []
    for (equal, scene), arms in judged.items():
        for first, second in PAIRS:
            found = gain(arms[first], arms[second])
            rows.append([scene, equal, first, second, found.percent, found.verdict])
    columns = ["scene", "equal", "first", "second", "gain [%]", "verdict"]
    return Table("The first against the second", columns, rows, WORDS("tables.verdicts"))


def judged_table(judged: Judged) -> Table:
    """A row for each run."""
    rows: list[list[Cell]] = []
    for (equal, scene), arms in judged.items():
        for family, cell in arms.items():
            updates = cell["updates"][-1]
            arm, last = Arm(cell["softening"], cell["both"], cell["rate"]), returns(cell)
            low, high = interval(partial(_means, last), len(last))
            ms = 1000 * float(np.mean(cell["cpu"])) / updates
            mean = f"{last.mean():.4g} [{low:.4g}, {high:.4g}]"
            rows.append([scene, equal, family, arm.label, updates, mean, last.min(), last.max(), ms])
    columns = ["scene", "equal", "arm", "setting", "updates", "return", "least", "most", "ms an update"]
    return Table("Judged on fresh seeds", columns, rows, WORDS("tables.judged"))


def chosen_table(rankings: Mapping[str, Mapping[str, list[Ranking]]], plan: Plan) -> Table:
    """Every setting on every rung."""
    rows: list[list[Cell]] = [
        [scene, family, arm.label, size.updates, value]
        for scene, families in rankings.items()
        for family, rungs in families.items()
        for size, ranking in reversed(list(zip(plan.rungs, rungs, strict=True)))
        for arm, (value,) in ranking
    ]
    return Table("Settings", ["scene", "arm", "setting", "updates", "return"], rows, WORDS("tables.chosen"))


def seeds_table(judged: Judged, plan: Plan) -> Table:
    """A row for each scene, budget and seed, and a column for each family."""
    families = list(next(iter(judged.values())))
    rows: list[list[Cell]] = [
        [scene, equal, seed, *values]
        for (equal, scene), arms in judged.items()
        for seed, *values in zip(plan.seeds, *(returns(arms[family]) for family in families), strict=True)
    ]
    return Table("Every seed", ["scene", "equal", "seed", *families], rows, WORDS("tables.seeds"))


def summary(judged: Judged) -> str:
    """A sentence for each pair that is asked for, by scene and what is equal."""
    parts = []
    for first, second in ASKED:
        told = []
        for scene in dict.fromkeys(scene for _, scene in judged):
            found = {equal: gain(arms[first], arms[second]) for (equal, of), arms in judged.items() if of == scene}
            told.append(
                f"{scene} " + ", ".join(f"{g.verdict} at equal {equal} ({g.percent} %)" for equal, g in found.items())
            )
        parts.append(f"{first} beats {second}: " + "; ".join(told) + ".")
    return " ".join(parts)


def gained(arms: Mapping[str, Outcome]) -> str:
    """The gains that are asked for, of one run of every family."""
    return ", ".join(f"over {second} {gain(arms[first], arms[second]).percent} %" for first, second in ASKED)


def _means(values: Array, rows: np.ndarray) -> Array:
    return values[rows].mean(axis=-1)  # type: ignore[no-any-return]
