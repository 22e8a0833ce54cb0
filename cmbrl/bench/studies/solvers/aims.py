"""The aims that the solver was built for, and what this run reached."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.studies.solvers.clock import LEVEL, Clock
from cmbrl.bench.studies.solvers.summary import Summary
from cmbrl.bench.study import Cell, Table

SHARE = 0.5  #: of DAQP's time, on the planar robots
G1_SECONDS = 60e-6


def aims(summary: Summary, clocks: Sequence[Clock]) -> Table:
    """One row an aim; left out where its problems or its rival are not there."""
    rows: list[Sequence[Cell]] = []
    batch = {c.robot: c for c in clocks}
    for robot in (r for r in ("hopper", "cheetah") if r in summary.families):
        ours, daqp, clock = _ours(summary, robot), _daqp(summary, robot), batch.get(robot)
        if ours and daqp:
            rows.append(_row(f"{robot}: one call / DAQP's call", ours / daqp, SHARE))
        if clock and daqp:
            rows.append(_row(f"{robot}: in a batch / DAQP's call", clock.batch / daqp, SHARE))
        if clock and clock.daqp:
            rows.append(_row(f"{robot}: in a batch / DAQP by its own clock", clock.batch / clock.daqp, SHARE))
    if "g1 feet" in summary.families and (g1 := _ours(summary, "g1 feet")):
        rows.append(_row("g1 feet: one call [us]", 1e6 * g1, 1e6 * G1_SECONDS))
    if "g1 feet" in batch:
        rows.append(_row("g1 feet: in a batch [us]", 1e6 * batch["g1 feet"].batch, 1e6 * G1_SECONDS))
    for name, problems in summary.families.items():
        failed = len(problems) - len(summary.times("ours", LEVEL, problems, "laws"))
        rows.append(_row(f"{name}: not below 1e-10, of {len(problems)}", failed, 0))
    return Table(
        "Aims of our solver on the exact law", ["aim", "reached", "at most", "verdict"], rows,
        "Ours: median over the problems brought below 1e-10 (natural map and momentum balance), by the cheapest "
        "tolerance that does. DAQP: median over all problems and tolerances, for the relaxation of the same problems.",
    )  # fmt: skip


def _row(aim: str, reached: float, bound: float) -> Sequence[Cell]:
    return [aim, reached, bound, "met" if reached <= bound else "missed"]


def _ours(summary: Summary, family: str) -> float | None:
    times = summary.times("ours", LEVEL, summary.families[family], "laws")
    return float(np.median(list(times.values()))) if times else None


def _daqp(summary: Summary, family: str) -> float | None:
    cells = summary.of_solver("convex", summary.families[family])
    return float(np.median([c.seconds for c in cells])) if cells else None
