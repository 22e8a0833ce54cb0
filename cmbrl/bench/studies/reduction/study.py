"""``cmbrl bench reduction``: what each reduction of the scene saves in time, and the difference it makes."""

from __future__ import annotations

from pathlib import Path

from cmbrl.bench.figures import save
from cmbrl.bench.studies.reduction.cells import BATCH, CHANGED, SOURCES, measure
from cmbrl.bench.studies.reduction.plots import bars
from cmbrl.bench.study import Section, Settings, Study, Table
from cmbrl.bench.words import Words
from cmbrl.jobs import Job, Runner

LABELS = tuple(SOURCES)
WORDS = Words("cmbrl.bench.studies.reduction")
COLUMNS = {
    "scene": "scene", "variant": "variant", "candidates": "candidates", "seconds": "us", "ratio": "ratio",
    "velocity_difference": "max |dv'|", "typical_difference": "median |dv'|", "position_difference": "max |dq'|",
    "changed": "changed", "iterations": "iterations", "failures": "failed", "states": "states",
}  # fmt: skip


def _study(folder: Path, settings: Settings, runner: Runner) -> Section:
    states, repeats = (2048, 5) if settings.quick else (8192, 15)
    size = {"states": states, "seed": settings.seed, "repeats": repeats}
    jobs = [Job(f"{scene} {states}", measure, {"scene": scene, **size}) for scene in settings.chosen(LABELS)]
    rows = [row for found in runner.run(jobs, "scene", alone=True) for row in found]
    save(bars(rows), folder / "reduction.png")
    medians = [{**row, "seconds": 1e6 * row["seconds"]["median"], "ratio": row["ratio"]["median"]} for row in rows]
    cells = [[row[key] for key in COLUMNS] for row in medians]
    table = Table(WORDS("tables.cost.title"), list(COLUMNS.values()), cells, WORDS("tables.cost.note", changed=CHANGED))
    return Section(WORDS("title"), WORDS("method", batch=BATCH), [table], WORDS.figures(), {"rows": rows})


STUDY = Study("reduction", WORDS("summary"), _study, LABELS)
