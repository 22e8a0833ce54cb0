"""``cmbrl bench speed``: microseconds per step and per derivative, next to MuJoCo's."""

from __future__ import annotations

from pathlib import Path

from cmbrl.bench.figures import save
from cmbrl.bench.scenes import LABELS
from cmbrl.bench.studies.speed.cells import measure
from cmbrl.bench.studies.speed.environments import PAIRS
from cmbrl.bench.studies.speed.environments import measure as environments
from cmbrl.bench.studies.speed.plots import bars
from cmbrl.bench.studies.speed.tables import WORDS, tables
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner
from cmbrl.runs import hardware, versions

FULL = {"states": 4096, "batch": 512, "batches": (64, 512, 4096), "repeats": 9, "candidates": 64}
QUICK = {**FULL, "states": 1024, "batches": (64, 512), "repeats": 3}


def _study(folder: Path, settings: Settings, runner: Runner) -> Section:
    scenes = settings.chosen(LABELS)
    size = {**(QUICK if settings.quick else FULL), "threads": settings.threads, "seed": settings.seed}
    name = f"{'quick' if settings.quick else 'full'} {settings.threads}"
    jobs = [Job(f"{scene} {name}", measure, {"scene": scene, **size}) for scene in scenes]
    found = runner.run(jobs, "scene", alone=True)
    turns = {"repeats": size["repeats"], "seed": settings.seed}
    robots = [scene for scene in PAIRS if scene in scenes]
    single = [Job(f"{robot} environment {name}", environments, {"scene": robot, **turns}) for robot in robots]
    isa = found[0]["isa"] if found else ""
    values = {
        "rows": [row for cell in found for row in cell["rows"]],
        "scaling": [row for cell in found for row in cell["scaling"]],
        "candidates": [cell["candidates"] for cell in found],
        "environments": runner.run(single, "environment", alone=True) if single else [],
        "machine": _machine(isa),
        "isa": isa,
        **{key: size[key] for key in ("batch", "states", "repeats", "seed", "threads")},
    }
    save(bars(values), folder / "speed.png")
    return Section(WORDS("title"), WORDS("method"), tables(values), WORDS.figures(), values)


def _machine(isa: str) -> str:
    known = versions()
    packages = ", ".join(f"{name} {known[name]}" for name in ("cmbrl", "mujoco", "numpy", "torch") if name in known)
    return f"{hardware()['processor']}, {hardware()['cores']} cores, {isa}; {packages}"


STUDY = Study("speed", WORDS("summary"), _study, LABELS)
