"""``cmbrl bench smoothing-robots``: hard, constant, Gaussian and published smoothing on robots, each at its best.

After the hopper and half-cheetah of Zhang, Jin, Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with
Contact Dynamics" (ICML 2023). Its constants are not published.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cmbrl.bench.studies.smoothing.halving import Ranking, chosen
from cmbrl.bench.studies.smoothing.plan import Arm
from cmbrl.bench.studies.smoothing_robots import plots, tables
from cmbrl.bench.studies.smoothing_robots.cells import Outcome, costs, trained
from cmbrl.bench.studies.smoothing_robots.plan import SCENES, Plan, Size, plan_of
from cmbrl.bench.studies.smoothing_robots.tables import SECONDS, UPDATES, WORDS, Judged
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner

FIGURE = "smoothing_robots.png"
Arms = Mapping[str, Arm]  #: by family


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """Scene by scene: settings first, then the judged runs at equal updates and at equal seconds, then all longer."""
    rankings: dict[str, dict[str, list[Ranking]]] = {}
    judged: Judged = {}
    longer = []
    scenes = settings.chosen(SCENES)
    for k, scene in enumerate(scenes):
        plan = _shifted(plan_of(scene, settings.quick), settings.seed)
        runner.seeds_a_job = len(plan.seeds)  # of what is judged
        at = [(k + part) / len(scenes) for part in (0.0, 0.3, 0.32, 0.8, 1.0)]
        found = chosen(plan, runner, (at[0], at[1]), trained, tables.score, episodes=plan.episodes)
        rankings |= found
        arms = {family: rungs[-1][0][0] for family, rungs in found[scene].items()}
        judged |= _judged(plan, arms, runner, at[1:4])
        longer.append(_longer(plan, arms, judged[UPDATES, scene], runner, (at[3], at[4])))
    plots.draw(judged, folder / FIGURE)
    return section(rankings, judged, ". ".join(longer) + ".", plan, settings.quick)


def _shifted(plan: Plan, seed: int) -> Plan:
    shift = seed * 1000
    choosing, seeds = (tuple(s + shift for s in of) for of in (plan.choosing, plan.seeds))
    return replace(plan, choosing=choosing, seeds=seeds)


def _judged(plan: Plan, arms: Arms, runner: Runner, at: Sequence[float]) -> Judged:
    """A run of every family and seed at equal updates, and at equal seconds."""
    (scene,) = plan.tasks
    inputs = {"task": scene, "arms": list(arms.values()), "size": plan.timed, "seeds": plan.seeds}
    job = Job(f"seconds {scene}", costs, inputs | {"episodes": plan.episodes, "turns": plan.turns})
    (seconds,) = runner.run([job], "timing", (at[0], at[1]), alone=True)
    wanted = {}
    for (family, arm), cost in zip(arms.items(), seconds, strict=True):
        fitting = max(1, round(plan.judged.updates * min(seconds) / cost))
        for equal, updates in ((UPDATES, plan.judged.updates), (SECONDS, fitting)):
            wanted[equal, family] = arm, replace(plan.judged, updates=updates)
    found = _of_seeds(plan, wanted, runner, (at[1], at[2]))
    return {
        (equal, scene): {family: cell for (of, family), cell in found.items() if of == equal}
        for equal in (UPDATES, SECONDS)
    }


def _of_seeds(
    plan: Plan, wanted: Mapping[tuple[str, str], tuple[Arm, Size]], runner: Runner, share: tuple[float, float]
) -> dict[tuple[str, str], Outcome]:
    """Runs of every seed, each a job of its own, as one outcome; equal ones run once."""
    (scene,) = plan.tasks
    jobs = {
        f"{scene} {arm.label} {size.updates} seed {seed}": {"arm": arm, "size": size, "seeds": (seed,)}
        for arm, size in wanted.values()
        for seed in plan.seeds
    }
    fixed = {"task": scene, "episodes": plan.episodes}
    cells = dict(
        zip(jobs, runner.run([Job(n, trained, fixed | i) for n, i in jobs.items()], "judged", share), strict=True)
    )
    merged = {}
    for key, (arm, size) in wanted.items():
        own = [cells[f"{scene} {arm.label} {size.updates} seed {seed}"] for seed in plan.seeds]
        returns = np.concatenate([np.array(cell["returns"], dtype=float) for cell in own], axis=1)
        merged[key] = own[0] | {"returns": returns, "cpu": [cell["cpu"][0] for cell in own]}
    return merged


def _longer(plan: Plan, arms: Arms, before: Mapping[str, Outcome], runner: Runner, share: tuple[float, float]) -> str:
    """What more updates do to the arms, and to the gains of the published rule."""
    (scene,) = plan.tasks
    short = replace(plan, seeds=plan.seeds[: plan.longer_seeds])
    wanted = {("longer", family): (arm, replace(plan.judged, updates=plan.longer)) for family, arm in arms.items()}
    cells = {family: cell for (_, family), cell in _of_seeds(short, wanted, runner, share).items()}
    told = ", ".join(
        f"{family} {tables.returns(before[family])[: len(short.seeds)].mean():.4g} to {tables.returns(cell).mean():.4g}"
        for family, cell in cells.items()
    )
    return f"{scene}: {told}; {tables.gained(cells)}"


def section(
    rankings: Mapping[str, Mapping[str, list[Ranking]]], judged: Judged, longer: str, plan: Plan, quick: bool
) -> Section:
    """Tables and text of finished runs."""
    method = WORDS(
        "method", judged=plan.judged, choosing=len(plan.choosing), seeds=len(plan.seeds), episodes=plan.episodes,
        tried=sum(len(arms) for arms in plan.tried.values()), rates=" and ".join(f"{rate:g}" for rate in plan.rates),
        keep=plan.keep, updates=" and ".join(str(size.updates) for size in plan.rungs),
    )  # fmt: skip
    text = "\n\n".join([
        *([WORDS("quick")] if quick else []), WORDS("question"), WORDS("answer"), method, tables.summary(judged),
        WORDS("longer", longer=plan.longer, judged=plan.judged, count=plan.longer_seeds, found=longer),
    ])  # fmt: skip
    shown = [tables.verdicts_table(judged), tables.judged_table(judged), tables.chosen_table(rankings, plan),
             tables.seeds_table(judged, plan)]  # fmt: skip
    values = {f"{equal} {scene}": dict(arms) for (equal, scene), arms in judged.items()}
    return Section(WORDS("title"), text, shown, [WORDS.figure(FIGURE)], values)


STUDY = Study(
    "smoothing-robots", "hard, constant, Gaussian and published smoothing on robots, each at its best", run,
    tuple(SCENES),
)  # fmt: skip
