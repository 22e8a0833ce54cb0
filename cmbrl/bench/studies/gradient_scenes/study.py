"""``cmbrl bench gradient-scenes``: derivatives through contact against closed forms and finite differences."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from cmbrl.bench.figures import save
from cmbrl.bench.studies.gradient_scenes import cells, cube, plots, tables
from cmbrl.bench.studies.gradient_scenes.tables import WORDS
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner
from cmbrl.models.step_settings import RK4

LABELS = (*plots.SCENES, cube.LABEL)
JUMPS = ("G5", "G6", "G7")  #: scenes across which estimators are compared


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """All scenes, or ``settings.scenes`` of them."""
    wanted = settings.scenes or LABELS
    names = [name for name, case in cells.all_cases().items() if case.label in wanted]
    jobs = [Job(name, cells.measure, {"name": name}) for name in names]
    rows = [cells.Row(**row) for found in runner.run(jobs, "case", (0.0, 0.8)) for row in found]
    shown, figures = [], []
    if rows:
        shown.append(tables.derivatives(rows))
        save(plots.bias(rows), folder / "gradient_scenes.png")
        figures.append(WORDS.figure("gradient_scenes.png"))
    if judged := [label for label in JUMPS if label in wanted]:
        sizes = (10, 30, 100, 300, 1000) if settings.quick else (10, 30, 100, 300, 1000, 3000)
        repeats = 10 if settings.quick else 30
        asked = {"labels": judged, "sizes": sizes, "repeats": repeats, "seed": settings.seed}
        (found,) = runner.run([Job("estimators across jumps", cells.bundles, asked)], "estimators", (0.8, 1.0))
        bundles = [cells.Bundle(**bundle) for bundle in found]
        shown.append(tables.across_jumps(bundles, repeats))
        save(plots.across_jumps(bundles), folder / "gradient_jumps.png")
        figures.append(WORDS.figure("gradient_jumps.png"))
    if cube.LABEL in wanted:
        steps = cube.STEPS[:2] if settings.quick else cube.STEPS
        finer = cube.RK4_STEPS[:1] if settings.quick else cube.RK4_STEPS
        shown.append(tables.bouncing_cube(cube.truth(), cube.measure(steps) + cube.measure(finer, RK4)))
    values = {"rows": [{**asdict(row), "verdict": row.verdict} for row in rows]}
    return Section(WORDS("title"), f"{WORDS('method')}\n\n{tables.findings(rows)}", shown, figures, values)


STUDY = Study("gradient-scenes", "derivatives through contact against closed forms and differences", run, LABELS)
