"""One cell of the table: a scene under one simulator at one step size; kept as JSON, so that a killed run goes on."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from cmbrl.bench.studies.stability.case import BankScene, NotExpressibleError
from cmbrl.bench.studies.stability.simulators import Simulator, seconds_per_step, simulate
from cmbrl.errors import UserError
from cmbrl.files import read_json, write_json

CLOSE = 0.01  #: an error of one per cent of the scene's scale, which many uses can live with
PASS, NEAR, FAIL, ABSENT = "pass", "within 1 %", "fail", "not expressible"


@dataclass(frozen=True)
class Cell:
    """error: of the worst case that the simulator can express, as a share of the scene's scale; None where it can
    express none. why: what it cannot express, and of which cases. failures: steps that it gave up itself. seconds: per
    physics step of the first case, None where that was not measured."""

    label: str
    simulator: str
    h: float
    error: float | None
    tolerance: float
    worst_case: str = ""
    why: str = ""
    failures: int = 0
    seconds: float | None = None

    @property
    def partial(self) -> bool:
        """Whether only some of the scene's cases are expressible."""
        return self.error is not None and bool(self.why)

    @property
    def verdict(self) -> str:
        """PASS within the scene's tolerance, NEAR within one per cent, else FAIL; ABSENT without words for it."""
        if self.error is None:
            return ABSENT
        if self.error <= self.tolerance and not self.failures:
            return PASS
        return NEAR if self.error <= CLOSE and not self.failures else FAIL


def measure(scene: BankScene, simulator: Simulator, h: float, timed: bool) -> Cell:
    """Runs every case of the scene; ``timed``: also the cost of a step of the first one that can be run."""
    worst, name, why, failures, seconds = None, "", "", 0, None
    for case in scene.cases:
        try:
            run, gave_up = simulate(simulator, case, h)
        except NotExpressibleError as reason:
            why = why or f"{case.name}: {reason}"
            continue
        finite = len(run.t) > case.steps(h) // run.every and np.isfinite(run.q[-1]).all()
        error = case.error(run) if finite else float("inf")
        error = error if np.isfinite(error) else float("inf")
        failures += gave_up
        if worst is None or error > worst:
            worst, name = error, case.name
        if timed and seconds is None and finite:
            seconds = seconds_per_step(simulator, case, h)
    return Cell(scene.label, simulator.name, h, worst, scene.tolerance(h), name, why, failures, seconds)


def remembered(scene: BankScene, simulator: Simulator, h: float, timed: bool, folder: Path) -> Cell:
    """The cell from ``folder`` where it is there, else measured and written there."""
    file = folder / f"{scene.label}_{simulator.name.replace(' ', '_').replace(',', '')}_{h:g}.json"
    try:
        held = read_json(file)
        return Cell(**{**held, "error": None if held["error"] is None else float(held["error"])})
    except UserError:
        cell = measure(scene, simulator, h, timed)
    plain = asdict(cell)
    plain["error"] = "inf" if cell.error == float("inf") else cell.error
    write_json(file, plain)
    return cell
