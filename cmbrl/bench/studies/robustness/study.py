"""``cmbrl bench robustness``: how often the solver reaches its tolerance on wild states, and whether it says so."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cmbrl.bench.studies.robustness.cells import SMOOTHINGS, TOLERANCE, cell
from cmbrl.bench.study import Section, Settings, Study, Table
from cmbrl.bench.words import Words
from cmbrl.jobs import Job, Runner

SIZES = {"hopper": 1_000_000, "cheetah": 1_000_000, "cube_toss": 1_000_000, "g1": 100_000}  #: states by scene
LAWS = ("mujoco", "rigid")
WORDS = Words("cmbrl.bench.studies.robustness")


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    cells = [
        {"scene": scene, "law": law, "smoothing": smoothing, "count": SIZES[scene] // (100 if settings.quick else 1)}
        for law in LAWS
        for scene in settings.chosen(SIZES)
        for smoothing in SMOOTHINGS
    ]
    jobs = [Job("{scene} {law} {smoothing}".format(**c), cell, {**c, "seed": settings.seed}) for c in cells]
    rows = runner.run(jobs, "cell")
    values = {"tolerance": TOLERANCE, "seed": settings.seed, "rows": rows}
    return Section(WORDS("title"), WORDS("method"), [table(rows)], values=values)


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """One row a cell."""
    counts = ("states", "by_fallback", "flagged", "silent", "nan")
    shown = [
        [
            r["scene"], r["law"], r["smoothing"], f"{100 * r['solved'] / r['states']:.4f}",
            *(r[key] for key in counts), round(r["iterations"], 1), r["worst_residual"],
        ]
        for r in rows
    ]  # fmt: skip
    columns = ("scene", "law", "smoothing", "solved %", *counts, "iterations", "worst residual")
    return Table("Wild random states", columns, shown, WORDS("table", tolerance=TOLERANCE))


STUDY = Study("robustness", "how often our solver reaches its tolerance on wild random states", run, tuple(SIZES))
