"""``cmbrl bench hidden``: what a fit is worth where the file is wrong.

The real system is MuJoCo with a robot that is not the file's: other parameters, a payload, another floor, or flaws that
no file tells. Every model starts from the file, and every hidden robot has its own log of random actions.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cmbrl.bench.studies.hidden import plots
from cmbrl.bench.studies.hidden.arms import FIT, ORACLE, Arm, arms
from cmbrl.bench.studies.hidden.cells import taught, untaught
from cmbrl.bench.studies.hidden.judge import Result
from cmbrl.bench.studies.hidden.plan import FAMILIES, FIRST_SEED, QUICK, SCENES, THRESHOLD, UPSIDE_DOWN, Plan
from cmbrl.bench.studies.hidden.tables import WORDS, tables
from cmbrl.bench.studies.hidden.without_data import name_of
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.envs.trials import LATE, PUSH
from cmbrl.jobs import Job, Runner

FIGURE = "hidden.png"


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """A job for each policy that is trained."""
    plan = QUICK if settings.quick else Plan()
    scenes = settings.scenes or (SCENES[:1] if settings.quick else SCENES)
    return section(runner.run(jobs(plan, scenes, FIRST_SEED + settings.seed), "policy"), folder, plan)


def jobs(plan: Plan, scenes: Sequence[str], first_seed: int) -> list[Job]:
    """What needs no draw, then draw by draw with fit and oracle first: a study that ends early has said most."""
    found = [_untaught(scene, width, first_seed + k, plan)
             for k in range(plan.base_seeds) for scene in scenes for width in (0.0, *plan.widths)]  # fmt: skip
    for draw in range(plan.draws):
        chosen = {name: arm for name, arm in arms(plan).items() if _takes(arm, draw, plan)}
        main, others = ([name for name in chosen if (name in (FIT, ORACLE)) == first] for first in (True, False))
        for names in (main, others):
            found += [
                _taught(scene, family, draw, name, first_seed + draw, plan)
                for scene in scenes
                for family in FAMILIES
                for name in names
                if family in chosen[name].families
            ]
    return found + [
        _taught(scene, family, 0, name, first_seed + plan.draws + k, plan)
        for k in range(plan.repeats)
        for scene in scenes
        for family in FAMILIES
        for name in (FIT, ORACLE)
    ]


def _takes(arm: Arm, draw: int, plan: Plan) -> bool:
    return arm.available() and (not arm.extra or draw < plan.extra_draws)


def _untaught(scene: str, width: float, seed: int, plan: Plan) -> Job:
    inputs = {"scene": scene, "width": width, "seed": seed, "plan": plan}
    return Job(f"{scene}-{name_of(width)}-{seed}", untaught, inputs)


def _taught(scene: str, family: str, draw: int, arm: str, seed: int, plan: Plan) -> Job:
    inputs = {"scene": scene, "family": family, "draw": draw, "arm": arm, "seed": seed, "plan": plan}
    return Job(f"{scene}-{family}-{draw}-{arm}-{seed}", taught, inputs)


def section(cells: Sequence[Result], folder: Path, plan: Plan) -> Section:
    """Pictures into ``folder``, tables and text of finished jobs."""
    plots.draws(cells, folder / FIGURE)
    return Section(WORDS("title"), _text(cells, plan), tables(cells), [WORDS.figure(FIGURE)], {"cells": list(cells)})


def _text(cells: Sequence[Result], plan: Plan) -> str:
    widths = " and ".join(f"{width:.0%}" for width in plan.widths)
    updates = " and ".join(f"{settings['iterations']:,} ({scene})" for scene, settings in plan.loop.items())
    method = WORDS(
        "method", draws=plan.draws, rows=plan.rows, extra=plan.extra_draws, seeds=plan.base_seeds, widths=widths,
        episodes=plan.episodes, upside_down=UPSIDE_DOWN, repeats=plan.repeats, updates=updates,
    )  # fmt: skip
    trials = WORDS("trials", trials=plan.trials, late=LATE, push=PUSH, threshold=THRESHOLD)
    failed = " ".join(
        f"{c['scene']}, {c['arm']}, {c.get('family', 'no draw')} {c.get('draw', '')}: {c['failed']}."
        for c in cells
        if c["failed"]
    )
    hours = sum(cell["cpu"] for cell in cells) / 3600
    return "\n\n".join([
        *([WORDS("quick")] if plan == QUICK else []),
        WORDS("question"),
        WORDS("answer"),
        method,
        trials,
        f"Training took {hours:.2g} core hours. " + (f"Ended early: {failed}" if failed else "No run diverged."),
    ])  # fmt: skip


STUDY = Study("hidden", "what a fit is worth where the real robot is not the one of its file", run, SCENES)
