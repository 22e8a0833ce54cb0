"""``cmbrl bench gradients``: bias, variance and cost of exact, smoothed and bundled policy gradients."""

from __future__ import annotations

from pathlib import Path

from cmbrl.bench.figures import save
from cmbrl.bench.studies.gradients import cells, plots, tables
from cmbrl.bench.studies.gradients.arms import LENGTHS, arms
from cmbrl.bench.studies.gradients.systems import SYSTEMS
from cmbrl.bench.studies.gradients.tables import WORDS
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner

LENGTH = 1e-3  #: the smoothing length [m] at which horizons are compared
HORIZON = 32  #: control steps at which everything else is compared


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """All systems, or ``settings.scenes`` of them; costs are measured one system at a time."""
    quick = settings.quick
    names = [name for name in SYSTEMS if not settings.scenes or name in settings.scenes]
    compared = tuple(arms(LENGTHS[1:] if quick else LENGTHS, (4,) if quick else (4, 16, 64)))
    asked = {"arms": compared, "samples": 32 if quick else 256, "seed": settings.seed}
    jobs = [
        Job(f"{name} {horizon}", cells.judge, {"system": name, "horizon": horizon, **asked})
        for name in names
        for horizon in ((4, 16, HORIZON) if quick else (4, 8, 16, HORIZON, 64, 128))
    ]
    found = runner.run(jobs, "system and horizon", (0.0, 0.8))
    rows = [cells.Quality(**quality) for qualities in found for quality in qualities]
    asked = {"arms": compared, "horizon": HORIZON, "samples": 64, "repeats": 1 if quick else 5}
    jobs = [Job(f"{name} costs", cells.costs, {"system": name, **asked}) for name in names]
    cost = dict(zip(names, runner.run(jobs, "cost", (0.8, 1.0), alone=True), strict=True))
    save(plots.against_cost(rows, HORIZON, cost), folder / "gradient_cost.png")
    save(plots.against_length(rows, HORIZON), folder / "gradient_length.png")
    save(plots.against_horizon(rows, LENGTH), folder / "gradient_horizon.png")
    save(plots.schedules(rows), folder / "gradient_schedules.png")
    text = f"{WORDS('method')}\n\n{tables.findings(rows, HORIZON)}"
    shown = [tables.estimators(rows, cost, HORIZON)]
    return Section(WORDS("title"), text, shown, WORDS.figures(), {"qualities": rows, "us_per_sample": cost})


STUDY = Study("gradients", "bias, variance and cost of policy-gradient estimators", run, tuple(SYSTEMS))
