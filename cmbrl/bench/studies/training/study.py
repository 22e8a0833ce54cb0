"""``cmbrl bench training``: what an update of a policy costs, next to MuJoCo simulating as many control steps."""

from __future__ import annotations

from pathlib import Path

from cmbrl.bench.studies.training.cells import ENVIRONMENTS, HORIZON, measure
from cmbrl.bench.study import Section, Settings, Study, Table
from cmbrl.bench.words import Words
from cmbrl.jobs import Job, Runner

ALWAYS = "bcg:trigger=0"
ROWS: dict[str, tuple[str, str | None]] = {
    "hopper": ("hopper", None),
    "cheetah": ("cheetah", None),
    "g1": ("g1", None),
    "g1-bcg": ("g1", "bcg"),
    "g1-bcg-always": ("g1", ALWAYS),
}
WORDS = Words("cmbrl.bench.studies.training")
COLUMNS = (
    *("task", "derivative", "model steps", "update [ms]", "fastest", "slowest"),
    *("rollout and gradient [ms]", "critic [ms]", "core alone [ms]", "mj_step alone [ms]", "mj_step / update"),
    "peak memory [GiB]",
)


def _study(folder: Path, settings: Settings, runner: Runner) -> Section:
    warm, repeats = (5, 3) if settings.quick else (60, 20)
    chosen = [label for label in ROWS if settings.scenes is None or label in settings.scenes]
    size = {"warm": warm, "repeats": repeats, "threads": settings.threads, "seed": settings.seed}
    jobs = []
    for label in chosen:
        task, derivative = ROWS[label]
        inputs = {"task": task, "derivative": derivative, **size}
        jobs.append(Job(f"{label} {repeats} {settings.threads}", measure, inputs))
    rows = []
    for found in runner.run(jobs, "task", alone=True):
        ms = found["ms"]
        update = [ms["update"][name] for name in ("median", "low", "high")]
        parts = [ms[part]["median"] if part in ms else None for part in ("rollout", "critic", "core", "mujoco")]
        rows.append([found["task"], found["derivative"], found["steps"], *update, *parts, found["ratio"], found["gib"]])
    clock = WORDS("clock.one") if settings.threads == 1 else WORDS("clock.more")
    note = WORDS("tables.update.note", episodes=ENVIRONMENTS, steps=HORIZON, clock=clock)
    table = Table(WORDS("tables.update.title"), COLUMNS, rows, note)
    return Section(WORDS("title"), WORDS("method"), [table], [], {"rows": rows, "threads": settings.threads})


STUDY = Study("training", WORDS("summary"), _study, tuple(ROWS))
