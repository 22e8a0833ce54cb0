"""``cmbrl bench throws``: a ball thrown at goals that only contact leads to, by eleven estimators of one gradient.

After the ball throw of Zhang, Jin, Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact
Dynamics" (ICML 2023), whose constants are lost: worlds, noise and step rule are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

from cmbrl.bench.studies.throws import figures
from cmbrl.bench.studies.throws.cells import (
    FITTED,
    KNOWN,
    PLANNER,
    QUICK,
    SCENES,
    Outcome,
    Work,
    descent_cell,
    fit_cell,
    mission_cell,
    variance_cell,
)
from cmbrl.bench.studies.throws.contenders import CONTENDERS
from cmbrl.bench.studies.throws.models import TASKS
from cmbrl.bench.studies.throws.summary import (
    claims_table,
    mission_table,
    mission_verdict,
    runs_table,
    variance_table,
    variance_verdict,
    verdict,
)
from cmbrl.bench.study import Figure, Progress, Section, Settings, Study, with_progress
from cmbrl.bench.workers import compute
from cmbrl.registry import load_task


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    work = QUICK if settings.quick else Work()
    return run(folder, settings, progress, replace(work, tasks=settings.scenes or work.tasks))


def run(folder: Path, settings: Settings, progress: Progress, work: Work) -> Section:
    """All parts, those that are in ``folder`` already not again, and the section of them."""
    seed, workers = settings.seed, settings.threads
    seeds = [seed + k for k in range(max(work.seeds, work.mission_seeds))]

    def phase(begin: float, end: float, what: str, function, jobs) -> list:  # type: ignore[no-untyped-def, type-arg]
        share = (end - begin) / len(jobs)
        return compute(function, jobs, workers, lambda n: progress(begin + share * n, f"{what} {n}/{len(jobs)}"))

    pairs = list(product(work.tasks, seeds))
    fits = dict(zip(pairs, phase(0.0, 0.2, "fit", fit_cell, [(folder, *p, work) for p in pairs]), strict=True))
    models = {task: [fits[task, s] for s in seeds[: work.seeds]] for task in work.tasks}
    runs = phase(
        0.2, 0.8, "descent", descent_cell,
        [(folder, task, scene, name, models[task], work, seed)
         for scene, task, name in product(SCENES, work.tasks, work.contenders)],
    )  # fmt: skip
    planned = phase(
        0.8, 0.9, "mission", mission_cell,
        [(folder, task, s, fits[task, s], work) for task, s in product(work.tasks, seeds[: work.mission_seeds])],
    )  # fmt: skip
    variances = phase(
        0.9, 1.0, "variance", variance_cell,
        [(folder, task, name, work, seed) for task, name in product(work.tasks, work.contenders)],
    )  # fmt: skip
    return section(runs, [row for rows in planned for row in rows], variances, work, folder)


def section(
    runs: Sequence[Outcome], planned: Sequence[Outcome], variances: Sequence[Outcome], work: Work, folder: Path
) -> Section:
    """Pictures into ``folder``, tables and text of finished cells."""
    substeps = load_task(work.tasks[0]).substeps
    for scene, file in ((KNOWN, "throws_known.png"), (FITTED, "throws_fitted.png")):
        figures.learning_curves([c for c in runs if c["scene"] == scene], folder / file)
    figures.real_distances(runs, folder / "throws_real.png")
    figures.variances(variances, work.lengths, substeps, folder / "throws_variance.png")
    figures.mission(planned, folder / "throws_mission.png")
    curves = "Thin: every run; thick: median; dotted: 5 cm."
    pictures = [
        Figure("throws_known.png", "Descent on the known scene", curves),
        Figure("throws_fitted.png", "Descent on fitted models, distance in them", curves),
        Figure("throws_real.png", "Last decisions in the real system", "Filled: planned on the known scene, hollow: on "
               "fitted models. Numbers: share within 5 cm (dotted)."),
        Figure("throws_variance.png", "Variance by length of the throw", "Median over decisions. FOPG has no noise."),
        Figure("throws_mission.png", "Real distance by recorded throws", "A dot and a cross for each seed."),
    ]  # fmt: skip
    tables = [claims_table(runs), mission_table(planned), runs_table(runs), variance_table(variances, work.lengths)]
    values = {"runs": list(runs), "mission": list(planned), "variance": list(variances)}
    return Section("Ball throws", text(runs, planned, variances, work), tables, pictures, values)


def text(runs: Sequence[Outcome], planned: Sequence[Outcome], variances: Sequence[Outcome], work: Work) -> str:
    """What was done, and what came out."""
    rule, plan = work.rule, work.mission
    how = "; ".join(f"{name}: {CONTENDERS[name].summary}" for name in work.contenders)
    return "\n\n".join(
        [
            "The decision is the launch velocity, in units of the action; the cost the squared distance to the goal at "
            "the end of the throw. The real system is pymunk. The known scene has its parameters; a fitted model has "
            f"friction, restitution and gravity fitted to {work.throws[-1]} random throws recorded there, another log "
            f"for every seed. Simulations are hard in all cases, derivatives differ. {work.starts} random first "
            f"decisions, the same for all, times {work.seeds} seeds of noise; {rule.iterations} iterations of Adam, "
            f"each of {rule.throws} throws however they are spent; its rate ({rule.rate:g}) and the noise on the "
            f"decision ({rule.std:g}) fall linearly to 0, the same for all. {how}.",
            "Of the paper's claims, " + verdict(runs),
            f"The mission plans on a fit, by {PLANNER} under draws from the fit's uncertainty ({plan.iterations} "
            f"iterations, rate {plan.rate:g}, noise {plan.std:g}) from the best {work.mission_starts} of "
            f"{work.candidates} random decisions in the model, and throws the one with the best mean return there. "
            + mission_verdict(planned),
            variance_verdict(variances),
        ]
    )


STUDY = Study(
    "throws",
    "launch velocity of a ball by eleven gradient estimators, and from 50 throws",
    with_progress(_study),
    tuple(TASKS),
)
