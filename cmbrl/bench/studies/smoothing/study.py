"""``cmbrl bench smoothing``: hard, constant, Gaussian and published smoothing on the ball throws, each at its best.

After the ball throw of Zhang, Jin, Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact
Dynamics" (ICML 2023). Its constants are not published; the scenes are those of ``cmbrl bench throws``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cmbrl.bench.studies.smoothing import plots, tables
from cmbrl.bench.studies.smoothing.cells import Outcome, costs, descended, score
from cmbrl.bench.studies.smoothing.halving import Ranking, chosen
from cmbrl.bench.studies.smoothing.plan import QUICK, Arm, Plan
from cmbrl.bench.studies.smoothing.tables import SECONDS, UPDATES, WORDS, Judged
from cmbrl.bench.studies.smoothing.verdicts import hits
from cmbrl.bench.studies.throws.cells import TASKS
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner

FIGURE = "smoothing_throws.png"


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """Settings first, then the judged runs at equal updates and at equal seconds, then all arms for longer."""
    plan = QUICK if settings.quick else Plan()
    shift = settings.seed * 1000
    plan = replace(
        plan, tasks=settings.scenes or plan.tasks, choosing=tuple(s + shift for s in plan.choosing),
        seeds=tuple(s + shift for s in plan.seeds),
    )  # fmt: skip
    runner.seeds_a_job = len(plan.seeds)
    rankings = chosen(plan, runner, (0.0, 0.4), descended, score)
    arms = {task: {family: rungs[-1][0][0] for family, rungs in own.items()} for task, own in rankings.items()}
    judged = _judged(plan, arms, runner)
    return section(rankings, judged, _longer(plan, arms, judged, runner), plan, folder)


def _judged(plan: Plan, arms: Mapping[str, Mapping[str, Arm]], runner: Runner) -> Judged:
    """A run of every family at equal updates, and at equal seconds."""
    timing = [
        Job(f"seconds {task}", costs,
            {"task": task, "arms": list(own.values()), "size": plan.timed, "seeds": plan.seeds, "turns": plan.turns})
        for task, own in arms.items()
    ]  # fmt: skip
    seconds = runner.run(timing, "timing", (0.4, 0.42), alone=True)
    jobs, where = [], []
    for (task, own), of in zip(arms.items(), seconds, strict=True):
        for (family, arm), cost in zip(own.items(), of, strict=True):
            fitting = max(1, round(plan.judged.updates * min(of) / cost))
            for equal, updates in ((UPDATES, plan.judged.updates), (SECONDS, fitting)):
                size = replace(plan.judged, updates=updates)
                inputs = {"task": task, "arm": arm, "size": size, "seeds": plan.seeds}
                jobs.append(Job(f"equal {equal} {task} {family}", descended, inputs))
                where.append((equal, task, family))
    found: dict[tuple[str, str], dict[str, Outcome]] = {}
    for (equal, task, family), cell in zip(where, runner.run(jobs, "judged", (0.42, 0.9)), strict=True):
        found.setdefault((equal, task), {})[family] = cell
    return found


def _longer(plan: Plan, arms: Mapping[str, Mapping[str, Arm]], judged: Judged, runner: Runner) -> str:
    """What more updates do to the arms of every task, and to the gains of the published rule."""
    seeds, size = plan.seeds[: plan.longer_seeds], replace(plan.judged, updates=plan.longer)
    where = [(task, family, arm) for task, own in arms.items() for family, arm in own.items()]
    jobs = [
        Job(f"longer {task} {family}", descended, {"task": task, "arm": arm, "size": size, "seeds": seeds})
        for task, family, arm in where
    ]
    found: dict[str, dict[str, Outcome]] = {task: {} for task in arms}
    for (task, family, _), cell in zip(where, runner.run(jobs, "longer", (0.9, 1.0)), strict=True):
        found[task][family] = cell
    told = []
    for task, cells in found.items():
        before = {family: hits(cell)[: len(seeds)].mean() for family, cell in judged[UPDATES, task].items()}
        shares = ", ".join(
            f"{family} {before[family]:.0%} to {hits(cell).mean():.0%}" for family, cell in cells.items()
        )
        told.append(f"{task}: {shares}; {tables.gained(cells)}")
    return ". ".join(told) + "."


def section(
    rankings: Mapping[str, Mapping[str, list[Ranking]]], judged: Judged, longer: str, plan: Plan, folder: Path
) -> Section:
    """The picture into ``folder``, tables and text of finished runs."""
    plots.draw(judged, folder / FIGURE)
    method = WORDS(
        "method", judged=plan.judged, rungs=plan.rungs, choosing=len(plan.choosing), seeds=len(plan.seeds),
        tried=sum(len(arms) for arms in plan.tried.values()), rates=" and ".join(f"{rate:g}" for rate in plan.rates),
        keep=plan.keep, updates=" and ".join(str(size.updates) for size in plan.rungs),
    )  # fmt: skip
    text = "\n\n".join([
        *([WORDS("quick")] if plan.rungs == QUICK.rungs else []), WORDS("question"), WORDS("answer"), method,
        tables.summary(judged),
        WORDS("longer", longer=plan.longer, judged=plan.judged, count=plan.longer_seeds, found=longer),
    ])  # fmt: skip
    shown = [tables.verdicts_table(judged), tables.judged_table(judged, plan), tables.chosen_table(rankings, plan),
             tables.seeds_table(judged, plan)]  # fmt: skip
    values = {f"{equal} {task}": dict(arms) for (equal, task), arms in judged.items()}
    return Section(WORDS("title"), text, shown, [WORDS.figure(FIGURE)], values)


STUDY = Study(
    "smoothing", "hard, constant, Gaussian and published smoothing on ball throws, each at its best", run, tuple(TASKS)
)
