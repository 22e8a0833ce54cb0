"""``cmbrl bench training``: what an update of a policy costs, next to MuJoCo simulating as many control steps."""

from __future__ import annotations

from pathlib import Path

from cmbrl.bench.studies.training.cells import ENVIRONMENTS, HORIZON, measure
from cmbrl.bench.study import Section, Settings, Study, Table
from cmbrl.bench.words import Words
from cmbrl.jobs import Job, Runner

LABELS = ("hopper", "cheetah")
WORDS = Words("cmbrl.bench.studies.training")
COLUMNS = (
    *("task", "control steps", "update [ms]", "fastest", "slowest"),
    *("rollout and gradient [ms]", "critic [ms]", "core alone [ms]", "mj_step alone [ms]", "mj_step / update"),
)


def _study(folder: Path, settings: Settings, runner: Runner) -> Section:
    warm, repeats = (5, 3) if settings.quick else (60, 20)
    scenes = [label for label in LABELS if settings.scenes is None or label in settings.scenes]
    size = {"warm": warm, "repeats": repeats, "seed": settings.seed}
    jobs = [Job(f"{scene} {repeats}", measure, {"scene": scene, **size}) for scene in scenes]
    rows = []
    for found in runner.run(jobs, "task", alone=True):
        update, *parts = (found["ms"][part] for part in ("update", "rollout", "critic", "core", "mujoco"))
        times = [update["median"], update["low"], update["high"], *(part["median"] for part in parts)]
        rows.append([found["task"], ENVIRONMENTS * HORIZON, *times, found["ratio"]])
    table = Table(WORDS("tables.update.title"), COLUMNS, rows, WORDS("tables.update.note"))
    return Section(WORDS("title"), WORDS("method"), [table], [], {"rows": rows})


STUDY = Study("training", WORDS("summary"), _study, LABELS)
