"""``cmbrl bench mission``: what policies earn in the real system, by method, from how much data and computing.

The real system is MuJoCo with the task's MJCF (Gymnasium's Hopper-v5 and HalfCheetah-v5). Methods on a log share one
log of random actions per seed. The last policy of every run counts, and every run is shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cmbrl.bench.studies.mission import plots
from cmbrl.bench.studies.mission.arms import ARMS, LOOP, LOOP_GAUSSIAN, MBPO_ONLINE, NOMINAL, QUICK, train
from cmbrl.bench.studies.mission.runs import Result, Work
from cmbrl.bench.studies.mission.tables import WORDS, table
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner

SCENES = ("hopper", "cheetah")
FIRST_SEED = 200  #: settings were chosen on smaller ones
SEEDS, OTHER = 3, {("hopper", LOOP): 10, ("cheetah", LOOP): 5, ("hopper", MBPO_ONLINE): 1, ("cheetah", MBPO_ONLINE): 1}


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """A job for each scene, method and seed."""
    work = QUICK if settings.quick else Work()
    scenes = settings.scenes or (SCENES[:1] if settings.quick else SCENES)
    return section(runner.run(jobs(work, scenes, FIRST_SEED + settings.seed), "run"), folder, work)


def jobs(work: Work, scenes: Sequence[str], first_seed: int) -> list[Job]:
    """Seed by seed, so that a study that ends early has said most; a quick one has one seed."""
    counts = {(s, arm): 1 if work is QUICK else OTHER.get((s, arm), SEEDS) for s in scenes for arm in ARMS}
    return [
        Job(f"{s}-{arm}-{first_seed + k}", train, {"scene": s, "arm": arm, "seed": first_seed + k, "work": work})
        for k in range(max(counts.values()))
        for (s, arm), count in counts.items()
        if k < count and ARMS[arm].available()
    ]


def section(results: Sequence[Result], folder: Path, work: Work) -> Section:
    """Pictures into ``folder``, tables and text of finished runs."""
    figures, tables = [], []
    for scene in dict.fromkeys(r["scene"] for r in results):
        own = [r for r in results if r["scene"] == scene]
        tables.append(table(scene, own))
        for kind, draw in (("transitions", plots.transitions), ("time", plots.times)):
            draw(scene, own, folder / f"{scene}_{kind}.png")
            figures.append(WORDS.figure(f"{scene}_{kind}.png"))
    return Section(WORDS("title"), _text(results, work), tables, figures, {"cells": list(results)})


def _text(results: Sequence[Result], work: Work) -> str:
    seconds = ", ".join(f"{work.seconds[s]:g} s on the {s}" for s in dict.fromkeys(r["scene"] for r in results))
    text = WORDS("method", transitions=work.transitions, gaussian=LOOP_GAUSSIAN, nominal=NOMINAL, first=FIRST_SEED,
                 seconds=seconds)  # fmt: skip
    absent = ", ".join(name for name, arm in ARMS.items() if not arm.available())
    failed = " ".join(f"{r['scene']}, {r['arm']}, seed {r['seed']}: {r['failed']}." for r in results if r["failed"])
    return "\n\n".join([
        *([WORDS("quick")] if work is QUICK else []),
        text,
        *([WORDS("absent", names=absent)] if absent else []),
        f"Ended early: {failed}" if failed else "No run diverged.",
    ])  # fmt: skip


STUDY = Study("mission", "what policies earn in the real system, from how much data and computing", run, SCENES)
