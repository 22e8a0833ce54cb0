"""One cell of the bank: a scene under one simulator at one step size; and what a step costs there."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.bench.peers.simulator import NotExpressibleError, Simulator
from cmbrl.bench.studies.stability.bank import SCENES, arms
from cmbrl.bench.studies.stability.case import BankScene, Case, Run

CLOSE = 0.01  #: an error of one per cent of the scene's scale, which many uses can live with
PASS, NEAR, FAIL, ABSENT = "pass", "within 1 %", "fail", "not expressible"
MOST_STEPS, MOST_SECONDS = 200, 0.1  #: of a timing


@dataclass(frozen=True)
class Cell:
    """error: of the worst case that the simulator can express, as a share of the scene's scale; None where it can
    express none. why: what it cannot express, and of which case. failures: steps that it gave up itself. runs: the
    first case that it runs to the end. seconds: per physics step of that case, None where that was not measured."""

    label: str
    simulator: str
    h: float
    error: float | None
    tolerance: float
    worst_case: str = ""
    why: str = ""
    failures: int = 0
    runs: str = ""
    seconds: float | None = None

    @classmethod
    def read(cls, held: dict[str, Any], seconds: float | None = None) -> Cell:
        """From what a job kept."""
        error = None if held["error"] is None else float(held["error"])
        return cls(**{**held, "error": error, "seconds": seconds})

    @property
    def partial(self) -> bool:
        """Whether only some of the scene's cases are expressible."""
        return self.error is not None and bool(self.why)

    @property
    def verdict(self) -> str:
        """PASS within the scene's tolerance, NEAR within one per cent, else FAIL; ABSENT if not expressible."""
        if self.error is None:
            return ABSENT
        if self.error <= self.tolerance and not self.failures:
            return PASS
        return NEAR if self.error <= CLOSE and not self.failures else FAIL


def cell(scene: str, arm: str, h: float) -> Cell:
    """Runs every case of the scene at steps of ``h`` [s]."""
    return measure(SCENES[scene], arm, h)


def measure(scene: BankScene, arm: str, h: float) -> Cell:
    """The same for a scene of any bank."""
    worst, name, why, failures, runs = None, "", "", 0, ""
    for case in scene.cases:
        try:
            simulator = arms()[arm](case.world)
        except NotExpressibleError as reason:
            why = why or f"{case.name}: {reason}"
            continue
        run = simulate(simulator, case, h)
        finite = len(run.t) > case.steps(h) // case.every(h) and np.isfinite(run.q[-1]).all()
        error = float(case.error(run)) if finite else float("inf")
        error = error if np.isfinite(error) else float("inf")
        failures += simulator.failures
        if worst is None or error > worst:
            worst, name = error, case.name
        runs = runs or (case.name if finite else "")
    return Cell(scene.label, arm, h, worst, scene.tolerance(h), name, why, failures, runs)


def simulate(simulator: Simulator, case: Case, h: float) -> Run:
    """The run, as far as it stays finite."""
    every = case.every(h)
    simulator.start(h, *case.start())
    states = [simulator.state()]
    for _ in range(case.steps(h) // every):
        simulator.step(case.control, every)
        states.append(simulator.state())
        if not all(np.isfinite(x).all() for x in states[-1]):
            break
    q, v = (np.array(x) for x in zip(*states, strict=True))
    return Run(case, h, h * every * np.arange(len(q), dtype=np.float64), q, v)


def seconds(scene: str, arm: str, h: float, case: str) -> float:
    """Processor time per physics step of one case: the best of up to three runs, one where it takes long.

    All steps are one call, so that the interpreter does not count where a simulator steps natively.
    """
    timed = next(one for one in SCENES[scene].cases if one.name == case)
    simulator, steps = arms()[arm](timed.world), min(timed.steps(h), MOST_STEPS)
    spent: list[float] = []
    while len(spent) < 3 and sum(spent) < MOST_SECONDS:
        simulator.start(h, *timed.start())
        begin = time.thread_time()
        simulator.step(timed.control, steps)
        spent.append(time.thread_time() - begin)
    return min(spent) / steps
