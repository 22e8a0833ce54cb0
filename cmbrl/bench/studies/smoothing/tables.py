"""Tables of finished runs, and the sentences that follow from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from cmbrl.bench.intervals import interval
from cmbrl.bench.studies.smoothing.cells import Outcome
from cmbrl.bench.studies.smoothing.halving import Ranking
from cmbrl.bench.studies.smoothing.plan import AIM, CONSTANT, GAUSSIAN, HARD, PUBLISHED, Arm, Plan
from cmbrl.bench.studies.smoothing.verdicts import DISTANCE, HITS, Gain, distances, gain, hits, measure_of
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words
from cmbrl.gradients.estimate import Array

WORDS = Words("cmbrl.bench.studies.smoothing")
UPDATES, SECONDS = "updates", "seconds"
UNITS = {HITS: "points of hits", DISTANCE: "% of the distance"}
PAIRS = ((PUBLISHED, CONSTANT), (PUBLISHED, HARD), (PUBLISHED, GAUSSIAN), (CONSTANT, HARD))  #: the first two are asked
ASKED = PAIRS[:2]
Judged = Mapping[tuple[str, str], Mapping[str, Outcome]]  #: by what is equal and task: a run of every family


def gains(judged: Judged, measure: str) -> Iterator[tuple[str, str, str, str, Gain]]:
    """What is equal, task, first, second, gain."""
    for (equal, task), arms in judged.items():
        for first, second in PAIRS:
            yield equal, task, first, second, gain(arms[first], arms[second], measure)


def verdicts_table(judged: Judged) -> Table:
    """A row for each task, budget and pair."""
    rows: list[list[Cell]] = []
    for by_hits, by_distance in zip(gains(judged, HITS), gains(judged, DISTANCE), strict=True):
        equal, task, first, second, _ = by_hits
        measure = measure_of(judged[equal, task])
        found = {HITS: by_hits[-1], DISTANCE: by_distance[-1]}
        rows.append([task, equal, first, second, *(found[m].percent for m in (HITS, DISTANCE)), measure,
                     found[measure].verdict])  # fmt: skip
    columns = [
        "throw",
        "equal",
        "first",
        "second",
        "gain in hits [points]",
        "gain in distance [%]",
        "decides",
        "verdict",
    ]
    return Table("The first against the second", columns, rows, WORDS("tables.verdicts"))


def judged_table(judged: Judged, plan: Plan) -> Table:
    """A row for each run."""
    rows: list[list[Cell]] = []
    for (equal, task), arms in judged.items():
        for family, cell in arms.items():
            updates = cell["updates"][-1]
            ms = 1000 * cell["cpu"] / updates / len(plan.seeds) / plan.judged.launches
            arm = Arm(cell["softening"], cell["both"], cell["rate"])
            rows.append([task, equal, family, arm.label, updates, _mean(hits(cell), 100, ".1f"),
                         100 * hits(cell, 2 * AIM).mean(), _mean(distances(cell), 1, ".3f"), ms])  # fmt: skip
    columns = [
        "throw",
        "equal",
        "arm",
        "setting",
        "updates",
        "hits [%]",
        "within 10 cm [%]",
        "distance [m]",
        "ms an update",
    ]
    return Table("Judged on fresh seeds", columns, rows, WORDS("tables.judged"))


def chosen_table(rankings: Mapping[str, Mapping[str, list[Ranking]]], plan: Plan) -> Table:
    """Every setting on every rung."""
    rows: list[list[Cell]] = [
        [task, family, arm.label, size.updates, 100 * share, -minus]
        for task, families in rankings.items()
        for family, rungs in families.items()
        for size, ranking in reversed(list(zip(plan.rungs, rungs, strict=True)))
        for arm, (share, minus) in ranking
    ]
    columns = ["throw", "arm", "setting", "updates", "hits [%]", "distance [m]"]
    return Table("Settings", columns, rows, WORDS("tables.chosen"))


def seeds_table(judged: Judged, plan: Plan) -> Table:
    """A row for each task, budget and seed, and a column for each family: hits [%] and distance [m]."""
    families = list(next(iter(judged.values())))
    rows: list[list[Cell]] = []
    for (equal, task), arms in judged.items():
        shown = [[f"{100 * h:.0f}, {d:.2f}" for h, d in zip(hits(arms[f]), distances(arms[f]), strict=True)]
                 for f in families]  # fmt: skip
        rows += [[task, equal, seed, *cells] for seed, *cells in zip(plan.seeds, *shown, strict=True)]
    columns = ["throw", "equal", "seed", *(f"{family} [%, m]" for family in families)]
    return Table("Every seed", columns, rows, WORDS("tables.seeds"))


def summary(judged: Judged) -> str:
    """A sentence for each pair that is asked for, by task and what is equal."""
    parts = []
    for first, second in ASKED:
        told = []
        for task in dict.fromkeys(task for _, task in judged):
            words = {}
            for equal in (UPDATES, SECONDS):
                arms = judged[equal, task]
                measure = measure_of(arms)
                found = gain(arms[first], arms[second], measure)
                words[equal] = f"{found.verdict} at equal {equal} ({found.percent} {UNITS[measure]})"
            told.append(f"{task} " + ", ".join(words.values()))
        parts.append(f"{first} beats {second}: " + "; ".join(told) + ".")
    return " ".join(parts)


def gained(arms: Mapping[str, Outcome]) -> str:
    """The gains in hits that are asked for, of one run of every family."""
    return ", ".join(f"over {second} {gain(arms[first], arms[second], HITS).percent} points" for first, second in ASKED)


def _mean(values: Array, unit: float, form: str) -> str:
    low, high = interval(lambda rows: values[rows].mean(axis=-1), len(values))
    return f"{unit * np.mean(values):{form}} [{unit * low:{form}}, {unit * high:{form}}]"
