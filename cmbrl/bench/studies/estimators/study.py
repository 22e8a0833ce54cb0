"""``cmbrl bench estimators``: which gradient estimator learns to walk fastest on a scene that is known exactly.

After figures 4 and 5a of Zhang, Jin & Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact
Dynamics" (ICML 2023). Their policies, budgets and axis values are not published; tasks, nets and sizes are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

from cmbrl.bench.studies.estimators import plots
from cmbrl.bench.studies.estimators.arms import ABLATION, ARMS, GROUPS
from cmbrl.bench.studies.estimators.cells import LEARNING, QUICK, Outcome, Work, train
from cmbrl.bench.studies.estimators.probe import probe
from cmbrl.bench.studies.estimators.tables import WORDS, Probes, claims, probe_table, returns_table
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner

TASKS = tuple(LEARNING)


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """Trainings, then one probe of all gradients for each task."""
    work = QUICK if settings.quick else Work()
    tasks = [task for task in TASKS if not settings.scenes or task in settings.scenes]
    runs = [
        Job(f"{task} {arm} {seed}", train,
            {"task": task, "arm": arm, "seed": seed, "learning": work.learning[task], "budget": work.budgets[task]})
        for seed, task, arm in product(range(settings.seed, settings.seed + work.seeds), tasks, work.arms)
    ]  # fmt: skip
    arms = [arm for arm in work.arms if ARMS[arm].estimator not in ("shac", "ars")]
    sizes = {"arms": arms, "seed": settings.seed, "updates": work.probe_updates, "samples": work.probe_samples}
    looks = [
        Job(f"gradients {task}", probe, {"task": task, "learning": work.learning[task], **sizes}) for task in tasks
    ]
    outcomes = runner.run(runs, "run", (0.0, 0.95))
    found = runner.run(looks, "task", (0.95, 1.0))
    return section(outcomes, dict(zip(tasks, found, strict=True)), folder, work)


def section(outcomes: Sequence[Outcome], probes: Probes, folder: Path, work: Work) -> Section:
    """Pictures into ``folder``, tables and text of finished runs."""
    tasks = list(probes)
    plots.curves(outcomes, tasks, GROUPS, folder / "returns.png")
    plots.curves(outcomes, tasks, ABLATION, folder / "kappa.png")
    plots.qualities(probes, folder / "gradients.png")
    method = WORDS(
        "method", windows=", ".join(f"{work.learning[t].horizon} ({t})" for t in tasks), seeds=work.seeds,
        seconds=", ".join(f"{t} {work.budgets[t].seconds:g} s" for t in tasks),
    )  # fmt: skip
    text = "\n\n".join([method, *(claims(outcomes, probes[task], task) for task in tasks)])
    values = {"runs": list(outcomes), "gradients": probes}
    tables = [returns_table(outcomes, tasks), probe_table(probes)]
    return Section(WORDS("title"), text, tables, WORDS.figures(), values)


STUDY = Study("estimators", "policies by gradient estimator on known scenes, equal seconds", run, TASKS)
