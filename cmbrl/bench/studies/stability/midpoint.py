"""What the midpoint integrator costs: the work of a step and of its Jacobian, against those of the default one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cmbrl.bench.peers.ours import Ours
from cmbrl.bench.studies.stability.bank import HARD, MIDPOINT, SCENES
from cmbrl.bench.studies.stability.case import WORDS, BankScene
from cmbrl.bench.studies.stability.tables import Results
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.timing import interleaved
from cmbrl.models.complementarity import ComplementarityModel

CONTACT = ("F2", "F7", "F10")  #: what it costs where it is not needed: contacts in space
STATES, REPEATS = 64, 15
INTEGRATORS = {HARD: None, MIDPOINT: "midpoint"}


def asked(scenes: Sequence[BankScene]) -> list[BankScene]:
    """The scenes of the table: those that must conserve something, which is what the integrator is for, and contact."""
    return [s for s in scenes if s.kind == "conservation" or s.label in CONTACT]


def measure(scene: str) -> dict[str, Any]:
    """Solver iterations of a step under each, and the ratios of the processor time of a step and of its Jacobian.

    The states are the first of the scene's first case, in one batch; both integrators take turns.
    """
    case = SCENES[scene].cases[0]
    h = SCENES[scene].shown_step(SCENES[scene].steps)
    models = {name: Ours(case.world, integrator=kind).model(h) for name, kind in INTEGRATORS.items()}
    q, v, u = _states(models[HARD], *case.start(), np.array(case.control, dtype=np.float64))
    work = {
        (name, jacobian): (lambda m=model, j=jacobian: m.predict(q, v, u, jacobian=j), STATES)
        for name, model in models.items()
        for jacobian in (False, True)
    }
    seconds = interleaved(work, REPEATS)
    steps = {name: float(m.predict(q, v, u).iterations.mean()) for name, m in models.items()}
    ratios = [float(np.median(seconds[MIDPOINT, j] / seconds[HARD, j])) for j in (False, True)]
    return {"iterations": steps, "step": ratios[0], "jacobian": ratios[1]}


def _states(
    model: ComplementarityModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The first STATES of a run from q (nq,), v (nv,) under u (nu,), stacked."""
    found = [(q, v)]
    while len(found) < STATES:
        r = model.predict(found[-1][0][None], found[-1][1][None], u[None])
        found.append((r.q_next[0], r.v_next[0]))
    return np.array([x for x, _ in found]), np.array([x for _, x in found]), np.tile(u, (STATES, 1))


def table(results: Results, measured: Mapping[str, Mapping[str, Any]]) -> Table:
    """Scene by scene: both verdicts, iterations, ratios."""
    rows: list[list[Cell]] = []
    for scene in asked(results.scenes):
        found = measured[scene.label]
        verdicts = [results.shown(scene, name).verdict for name in INTEGRATORS]
        iterations = [found["iterations"][name] for name in INTEGRATORS]
        rows.append([scene.name, *verdicts, *iterations, found["step"], found["jacobian"]])
    columns = ["scene", HARD, MIDPOINT, "iterations", "with midpoint", "time of a step", "with Jacobian"]
    return Table("What midpoint costs, against ours hard", columns, rows, WORDS("tables.midpoint"))
