"""``cmbrl bench speed``: microseconds per step and per derivative, next to MuJoCo's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.bench.figures import save
from cmbrl.bench.scenes import LABELS
from cmbrl.bench.studies.speed import growth, robots
from cmbrl.bench.studies.speed.cells import measure
from cmbrl.bench.studies.speed.environments import PAIRS
from cmbrl.bench.studies.speed.environments import measure as environments
from cmbrl.bench.studies.speed.plots import bars, curves
from cmbrl.bench.studies.speed.tables import WORDS, growth_tables, robot_tables, tables
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner
from cmbrl.runs import hardware, versions

FULL: dict[str, Any] = {"states": 4096, "batch": 512, "batches": (64, 512, 4096), "repeats": 9, "candidates": 64}
QUICK: dict[str, Any] = {**FULL, "states": 1024, "batches": (64, 512), "repeats": 3}
EACH = {"states": 256, "batch": 256}  #: of a robot, and of a size


def _study(folder: Path, settings: Settings, runner: Runner) -> Section:
    if settings.robots is not None:
        return _robots(settings, runner)
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
    rows = _growth(settings, runner)
    values["growth"] = rows
    figures = []
    if found:
        save(bars(values), folder / "speed.png")
        figures.append(WORDS.figure("speed.png"))
    if rows:
        save(curves(rows), folder / "growth.png")
        figures.append(WORDS.figure("growth.png"))
    shown = [*(tables(values) if found else []), *growth_tables(values)]
    return Section(WORDS("title"), WORDS("method"), shown, figures, values)


def _each(settings: Settings) -> dict[str, int]:
    repeats = int((QUICK if settings.quick else FULL)["repeats"])
    return {**EACH, "repeats": repeats, "seed": settings.seed}


def _growth(settings: Settings, runner: Runner) -> list[dict[str, Any]]:
    """A row of every size of what was asked for."""
    size = _each(settings)
    wanted = [(what, n) for what in settings.chosen(growth.SIZES) for n in growth.SIZES[what]]
    jobs = [
        Job(f"{what} {n} {size['repeats']}", growth.measure, {"what": what, "size": n, **size}) for what, n in wanted
    ]
    return runner.run(jobs, "size", alone=True) if jobs else []


def _robots(settings: Settings, runner: Runner) -> Section:
    """A row of every robot of the folder, and nothing else."""
    size, files = _each(settings), robots.robot_files(settings.robots or "")
    jobs = [
        Job(f"robot {robots.robot_name(file)} {size['repeats']}", robots.measure, {"file": str(file), **size})
        for file in files
    ]
    rows = runner.run(jobs, "robot", alone=True)
    values = {"rows": rows, "machine": _machine(""), **size}
    return Section(WORDS("robots.title"), WORDS("robots.method"), robot_tables(values), [], values)


def _machine(isa: str) -> str:
    known = versions()
    packages = ", ".join(f"{name} {known[name]}" for name in ("cmbrl", "mujoco", "numpy", "torch") if name in known)
    told = [hardware()["processor"], f"{hardware()['cores']} cores", *([isa] if isa else [])]
    return f"{', '.join(told)}; {packages}"


STUDY = Study("speed", WORDS("summary"), _study, (*LABELS, *growth.SIZES))
