"""``cmbrl bench simulators``: what a simulated second costs at which error: ours, MuJoCo's integrators, MJX, pymunk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from cmbrl.bench.figures import save
from cmbrl.bench.studies.simulators.arms import LANES, absent
from cmbrl.bench.studies.simulators.cells import LOST, QUICK, Effort, Result, measure
from cmbrl.bench.studies.simulators.plots import plot
from cmbrl.bench.studies.simulators.scenes import LABELS
from cmbrl.bench.studies.simulators.tables import WORDS, costs, limits
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.jobs import Job, Runner


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    effort = QUICK if settings.quick else Effort()
    jobs = [
        Job(label, measure, {"label": label, "effort": effort, "seed": settings.seed})
        for label in settings.chosen(LABELS)
    ]
    return section([Result.read(held) for held in runner.run(jobs, "scene", alone=True)], folder)


def section(results: Sequence[Result], folder: Path) -> Section:
    """Pictures into ``folder``, tables and text of finished scenes."""
    save(plot(results, own=True), folder / "simulators_own.png", dpi=130)
    save(plot(results, own=False), folder / "simulators_truth.png", dpi=130)
    text = WORDS("method", states=max((result.states for result in results), default=0), lanes=LANES, lost=LOST)
    if missing := absent():
        text += f" Not installed, so not measured: {', '.join(missing)}."
    values = {"results": [asdict(result) for result in results]}
    return Section(WORDS("title"), text, [costs(results), limits(results)], WORDS.figures(), values)


STUDY = Study("simulators", "seconds per simulated second against trajectory error, with competitors", run, LABELS)
