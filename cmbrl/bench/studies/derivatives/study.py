"""``cmbrl bench derivatives``: every column of the step's Jacobian on states near contact."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cmbrl.bench.states import SCENES, bench_scene
from cmbrl.bench.studies.derivatives.differences import SMOOTHINGS, measure
from cmbrl.bench.study import Section, Settings, Study, Table
from cmbrl.bench.words import Words
from cmbrl.jobs import Job, Runner

STATES, QUICK_STATES = 1000, 20
WORDS = Words("cmbrl.bench.studies.derivatives")
KEYS = (
    *("scene", "law", "smoothing", "restitution", "median", "worst", "worst_column"),
    *("columns", "across_kinks", "vague", "one_sided", "unsolved"),
)


def cell(scene: str, smoothing: str, states: int, seed: int) -> dict[str, Any]:
    """The errors of one scene under one smoothing."""
    return {"scene": scene, **measure(bench_scene(scene), smoothing, states, seed)}


def table(rows: Sequence[dict[str, Any]], states: int) -> Table:
    """Error of all columns of a state together, then of the worst single column, and what was left out."""
    cells = []
    for row in rows:
        kinds = sorted(row["kinds"].items(), key=lambda item: -item[1]["worst"])[:3]
        cells.append([*(row[key] for key in KEYS), ", ".join(f"{kind} {x['worst']:.0e}" for kind, x in kinds)])
    columns = [*(key.replace("_", " ") for key in KEYS), "worst kinds"]
    return Table(WORDS("tables.errors.title", states=states), columns, cells, WORDS("tables.errors.note"))


def _study(folder: Path, settings: Settings, runner: Runner) -> Section:
    states = QUICK_STATES if settings.quick else STATES
    jobs = [
        Job(f"{scene} {smoothing} {states}", cell,
            {"scene": scene, "smoothing": smoothing, "states": states, "seed": settings.seed})
        for scene in settings.chosen(SCENES) for smoothing in SMOOTHINGS
    ]  # fmt: skip
    rows = runner.run(jobs, "scene and smoothing")
    values = {"states": states, "seed": settings.seed, "rows": rows}
    return Section(WORDS("title"), WORDS("method"), [table(rows, states)], values=values)


STUDY = Study("derivatives", WORDS("summary"), _study, SCENES)
