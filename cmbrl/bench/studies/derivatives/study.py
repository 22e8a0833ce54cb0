"""``cmbrl bench derivatives``: every column of the step's Jacobian on states near contact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.bench.states import SCENES, bench_scenes
from cmbrl.bench.studies.derivatives.differences import SMOOTHINGS, run
from cmbrl.bench.study import Progress, Section, Settings, Study, Table, with_progress
from cmbrl.errors import UserError

STATES, QUICK_STATES = 1000, 20


def table(result: dict[str, Any]) -> Table:
    """Error of all columns of a state together, then of the worst single column, and what was left out."""
    columns = ["scene", "law", "smoothing", "restitution", "median", "worst", "worst column", "columns", "across kinks"]
    rows = []
    for r in result["rows"]:
        kinds = sorted(r["kinds"].items(), key=lambda item: -item[1]["worst"])[:3]
        worst = ", ".join(f"{kind} {x['worst']:.0e}" for kind, x in kinds)
        errors = [r["median"], r["worst"], r["worst_column"]]
        counts = [r[key] for key in ("columns", "across_kinks", "vague", "one_sided", "unsolved")]
        rows.append([r["scene"], r["law"], r["smoothing"], r["restitution"], *errors, *counts, worst])
    note = (
        "relative errors; columns across a kink of the model, or too vague to tell by differences, are left out and "
        "counted"
    )
    return Table(
        f"Against finite differences, {result['states']} states near contact",
        [*columns, "vague", "one-sided", "unsolved", "worst kinds"],
        rows,
        note,
    )


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    scenes = bench_scenes()
    chosen = settings.scenes or tuple(scenes)
    if missing := [label for label in chosen if label not in scenes]:
        raise UserError(f"the scene {missing[0]} needs a file that is not part of the repository: leave it out")
    total, done = len(chosen) * len(SMOOTHINGS), 0

    def count(pieces: int) -> None:
        nonlocal done
        done += pieces
        progress(done / total, f"{done} of {total} scenes and smoothings")

    states = QUICK_STATES if settings.quick else STATES
    scenes = {label: scenes[label] for label in chosen}
    result = run(scenes, states, settings.seed, threads=settings.threads, progress=count)
    text = (
        "The full Jacobian of one step in configuration, velocity, control and parameters against 4-point differences "
        "of the same softened step, column by column, on random states near contact."
    )
    return Section("Derivatives of the step", text, [table(result)], values=result)


STUDY = Study(
    "derivatives", "our derivatives against finite differences of the same softened step", with_progress(_study), SCENES
)
