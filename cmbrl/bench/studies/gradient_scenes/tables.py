"""Derivatives by case, and estimators across jumps."""

from __future__ import annotations

from collections.abc import Sequence

from cmbrl.bench.studies.gradient_scenes import cube
from cmbrl.bench.studies.gradient_scenes.cells import SMOOTHINGS, Bundle, Row
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.gradient_scenes")
SHOWN = ("hard", "kappa 1e-06", "kappa 1e-04", "kappa 1e-02", "gaussian")
SIZE = 1000  #: of the bundles in the table


def derivatives(rows: Sequence[Row]) -> Table:
    """One line a derivative."""

    def cells(row: Row) -> list[Cell]:
        truth: Cell = row.truth if row.upper == row.truth else f"[{row.truth:g}, {row.upper:g}]"
        worst = max(row.mismatch(name) for name in row.ours)
        ours = (row.ours[name] for name in SHOWN)
        return [row.label, row.title, row.wrt, truth, *ours, worst, row.mujoco, row.verdict, row.remark]

    columns = ["scene", "case", "derivative", "true", *SHOWN, "worst |ours - differences|", "MuJoCo differences",
               "verdict", "what it shows"]  # fmt: skip
    note = WORDS("tables.derivatives", smoothings=len(SMOOTHINGS))
    return Table("Derivatives by scene", columns, [cells(row) for row in rows], note)


def across_jumps(bundles: Sequence[Bundle], repeats: int) -> Table:
    """One line an estimator and jump."""
    rows: list[list[Cell]] = [
        [b.label, b.title, b.order, b.truth, b.mean, b.rms, b.reported, b.variance] for b in bundles if b.size == SIZE
    ]
    columns = ["scene", "case", "estimator", "true", "mean", "rms error", "error it reports", "variance of one sample"]
    return Table(f"Estimators across jumps, {SIZE:,} samples", columns, rows, WORDS("tables.jumps", repeats=repeats))


def bouncing_cube(truth: float, found: Sequence[cube.Derivative]) -> Table:
    """Ours and MuJoCo's by number of steps, then what DiffMJX publishes of its own law of collision."""
    rows: list[list[Cell]] = [
        [f"ours, {d.integrator}, {d.steps:,} steps", truth, d.ours, d.mujoco, d.seconds, abs(d.ours / truth - 1)]
        for d in found
    ]
    theirs = cube.PUBLISHED[-1][2]
    rows += [[name, theirs, a, b, seconds, abs(a / theirs - 1)] for name, a, b, seconds in cube.PUBLISHED]
    columns = ["solver", "true", "derivative", "differences", "seconds", "relative error"]
    return Table("Bouncing cube of DiffMJX, 1 s", columns, rows, WORDS("tables.cube"))


def findings(rows: Sequence[Row]) -> str:
    """How many derivatives pass, and which miss the truth."""
    missed = sorted({f"{r.label} ({r.title})" for r in rows if r.misses})
    passed = sum(r.verdict == "pass" for r in rows)
    failures = sum({(r.label, r.title): r.failures for r in rows}.values())
    text = f"{passed} of {len(rows)} derivatives pass both tests; {failures} solves failed."
    return text + (f" The truth is missed in {', '.join(missed)}; the table gives reasons." if missed else "")
