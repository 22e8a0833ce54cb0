"""The tables of the study: what each simulator costs at which error, and how far the contact laws are apart."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from cmbrl.bench.studies.simulators.cells import Result, Row
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words

GOAL = 0.01  #: relative error whose cost the table names
WORDS = Words("cmbrl.bench.studies.simulators")


def costs(results: Sequence[Result]) -> Table:
    """One row a scene and simulator."""
    rows: list[list[Cell]] = []
    for result in results:
        for engine in dict.fromkeys(row.engine for row in result.rows):
            mine = [row for row in result.rows if row.engine == engine]
            at = min(mine, key=lambda row: abs(row.step - result.file_step))
            lost, unsolved = sum(row.failed for row in mine), sum(row.unsolved for row in mine)
            error = (at.own[1], at.truth[1], at.truth[2])
            rows.append([result.label, engine, 1e3 * at.step, at.seconds, *error, cost_of(mine, GOAL), lost, unsolved])
    columns = [
        "scene", "simulator", "step [ms]", "s per sim s", "error, own limit", "error, truth", "90 %",
        "s per sim s at 1 % of own limit", "lost", "unsolved",
    ]  # fmt: skip
    return Table("Cost and error", columns, rows, WORDS("tables.costs"))


def limits(results: Sequence[Result]) -> Table:
    """One row a scene and contact law."""
    rows: list[list[Cell]] = [
        [result.label, name, limit["floor"], limit["truth"] if name != result.truth else 0.0]
        for result in results
        for name, limit in result.limits.items()
    ]
    columns = ["scene", "limit", "uncertainty", "error to truth"]
    return Table("Limits of the contact laws", columns, rows, WORDS("tables.limits"))


def cost_of(rows: Sequence[Row], goal: float) -> float | None:
    """Seconds per simulated second at which the median error to the own limit first falls to ``goal``; None: never.

    Between two steps the cost is interpolated, both on logarithmic scales.
    """
    ordered = sorted(rows, key=lambda row: row.seconds)
    points = [(row.seconds, row.own[1]) for row in ordered if row.own[1] is not None]
    if points and points[0][1] <= goal:
        return points[0][0]
    for (cheap, high), (dear, low) in pairwise(points):
        if low <= goal:
            share = np.log(high / goal) / np.log(high / max(low, 1e-300))
            return float(cheap * (dear / cheap) ** share)
    return None
