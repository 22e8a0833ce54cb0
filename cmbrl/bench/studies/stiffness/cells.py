"""One cell of the sweep: all models learn from the same tosses on ground of one stiffness, judged one step ahead."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from cmbrl.accuracy.strata import in_contact
from cmbrl.bench.studies.stiffness.tosses import record
from cmbrl.data.transitions import Transitions
from cmbrl.fitting import Budget, fit
from cmbrl.models.baselines import Ballistic
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.models.protocol import Model
from cmbrl.registry import load_task
from cmbrl.scene import Scene

SUBSTEPS = 4  #: physics steps of our models in a transition
_TEST_SEED = 1_000_000
_LAWS = {"soft": "mujoco", "rigid": "rigid"}


@dataclass(frozen=True)
class Work:
    """Sizes. ``updates``: of the ensemble; at stiffness 100, 2,000 and 5,000 change its error by less than 5 %."""

    stiffness: tuple[float, ...] = (100.0, 300.0, 500.0, 1000.0, 2500.0)
    seeds: int = 3
    rows: int = 1000
    test_rows: int = 5000
    updates: int = 1000
    budget: Budget = field(default_factory=Budget)


_SMALL = Budget(
    trial_rows=500, trial_rounds=1, trial_population=16, trial_iterations=4, held_out_rows=500, search_rows=500,
    search_rounds=5, search_population=32, polish_rows=1000, polish_iterations=6,
)  # fmt: skip
QUICK = Work(stiffness=(100.0, 2500.0), seeds=1, test_rows=2000, updates=500, budget=_SMALL)


def cell(stiffness: float, seed: int, work: Work) -> dict[str, dict[str, float]]:
    """Errors of v' by model (:func:`errors`), and seconds of training (processor time), all from the same rows."""
    log, test = record(stiffness, work.rows, seed), record(stiffness, work.test_rows, _TEST_SEED + seed)
    out: dict[str, dict[str, float]] = {}

    def add(name: str, model: Model, seconds: float) -> None:
        out[name] = {**errors(model, test), "seconds": seconds}

    task = load_task("cube_toss")
    h = task.control_dt / SUBSTEPS
    for word, law in _LAWS.items():
        scene = Scene.from_mjcf(task.scene_path, contact_law=law)
        nominal = ComplementarityModel(scene, substeps=SUBSTEPS, time_step=h)
        add(f"{word}, nominal", nominal, 0.0)
        begin = time.process_time()
        fitted = fit(nominal, log, seed=seed, budget=work.budget).model
        add(f"{word}, fitted", fitted, time.process_time() - begin)
    scene = task.load_scene()
    ensemble = NeuralEnsemble(scene, task.control_dt, EnsembleConfig(updates=work.updates, angles="periodic"))
    begin = time.process_time()
    ensemble.fit(log, seed=seed)
    add("neural ensemble", ensemble, time.process_time() - begin)
    add("ballistic", Ballistic(scene, task.control_dt), 0.0)
    return out


@torch.no_grad()
def errors(model: Model, test: Transitions) -> dict[str, float]:
    """One-step errors on ``test``.

    ``all``, ``contact``, ``flight``: root mean square over rows and coordinates, relative to the standard deviation of
    the change of each coordinate in ``test``. ``turn`` [rad/s]: of the angular velocity, all rows.
    """
    predicted = model.step(*(torch.as_tensor(x) for x in (test.q, test.v, test.u)))[1].numpy()
    off = predicted - test.v_next
    squares = np.mean((off / np.std(test.v_next - test.v, axis=0)) ** 2, axis=1)
    scene = load_task("cube_toss").load_scene()
    contact = in_contact(test, scene, 2e-3)
    parts = {"all": np.ones(len(test), dtype=bool), "contact": contact, "flight": ~contact}
    found: dict[str, Any] = {name: float(np.sqrt(np.mean(squares[rows]))) for name, rows in parts.items()}
    return {**found, "turn": float(np.sqrt(np.mean(off[:, 3:] ** 2)))}
