"""``cmbrl bench throws``: a ball thrown at goals that only contact leads to, by eleven estimators of one gradient.

After the ball throw of Zhang, Jin, Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact
Dynamics" (ICML 2023). Its constants are not published; worlds, noise and step rule are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

from cmbrl.bench.studies.throws import cells, plots, tables
from cmbrl.bench.studies.throws.cells import FITTED, KNOWN, PLANNER, QUICK, TASKS, Outcome, Work
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner
from cmbrl.registry import load_task


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """Fits first, then descents and plans on them, then variances; pictures into ``folder``."""
    work, seed = QUICK if settings.quick else Work(), settings.seed
    work = replace(work, tasks=settings.scenes or work.tasks)
    seeds = range(seed, seed + max(work.seeds, work.planned))
    pairs = list(product(work.tasks, seeds))
    fitting = [
        Job(f"fit {task} {s}", cells.fits, {"task": task, "throws": work.throws, "draws": work.draws, "seed": s})
        for task, s in pairs
    ]
    found = dict(zip(pairs, runner.run(fitting, "fit", (0.0, 0.2)), strict=True))
    thetas = {(FITTED, task): [found[task, s][-1]["theta"] for s in seeds[: work.seeds]] for task in work.tasks}
    thetas |= {(KNOWN, task): [cells.known(task).tolist()] * work.seeds for task in work.tasks}
    common = {"rule": work.rule, "starts": work.starts, "seed": seed}
    descents = [
        Job(f"descent {task} {scene} {arm}", cells.descent,
            {"task": task, "scene": scene, "arm": arm, "thetas": thetas[scene, task], **common})
        for scene, task, arm in product((KNOWN, FITTED), work.tasks, work.arms)
    ]  # fmt: skip
    planning = [
        Job(f"plan {task} {s} {throws}", cells.plan,
            {"task": task, "seed": s, "throws": throws, "model": model, "planning": work.planning})
        for task, s in product(work.tasks, seeds[: work.planned])
        for throws, model in zip(work.throws, found[task, s], strict=True)
    ]  # fmt: skip
    sizes = {"lengths": work.lengths, "points": work.points, "samples": work.samples, "std": work.rule.std}
    looks = [
        Job(f"variance {task} {arm}", cells.variance, {"task": task, "arm": arm, **sizes, "seed": seed})
        for task, arm in product(work.tasks, work.arms)
    ]
    runs = runner.run(descents, "descent", (0.2, 0.8))
    planned = runner.run(planning, "plan", (0.8, 0.9))
    return section(runs, planned, runner.run(looks, "variance", (0.9, 1.0)), work, folder)


def section(
    runs: Sequence[Outcome], planned: Sequence[Outcome], variances: Sequence[Outcome], work: Work, folder: Path
) -> Section:
    """Pictures into ``folder``, tables and text of finished cells."""
    words = tables.WORDS
    for scene, file in ((KNOWN, "throws_known.png"), (FITTED, "throws_fitted.png")):
        plots.learning_curves([c for c in runs if c["scene"] == scene], folder / file)
    plots.real_distances(runs, folder / "throws_real.png")
    plots.variances(variances, work.lengths, load_task(work.tasks[0]).substeps, folder / "throws_variance.png")
    plots.planned(planned, folder / "throws_mission.png")
    text = words(
        "method", work=work, rule=work.rule, planning=work.planning, recorded=work.throws[-1], planner=PLANNER,
        claims=tables.verdict(runs), planned=tables.planned_verdict(planned),
        variance=tables.variance_verdict(variances),
    )  # fmt: skip
    shown = [tables.claims_table(runs), tables.planned_table(planned), tables.runs_table(runs),
             tables.variance_table(variances, work.lengths)]  # fmt: skip
    values = {"runs": list(runs), "planned": list(planned), "variance": list(variances)}
    return Section(words("title"), text, shown, words.figures(), values)


STUDY = Study(
    "throws", "launch velocity of a ball by eleven gradient estimators, and from 50 throws", run, tuple(TASKS)
)
