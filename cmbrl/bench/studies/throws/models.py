"""The models that throws are planned on: the known scene, and fits of 10, 25 and 50 recorded throws."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.contact.smoothing import Exact
from cmbrl.data.transitions import Transitions
from cmbrl.fitting import fit
from cmbrl.gradients.estimate import Array
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task

TASKS = {
    "ball_throw": "off ground and wall, and back",
    "ball_over": "over the wall by a bounce",
    "ball_slide": "slide to a stop, no bounce",
}  #: and what the picture calls them
TRUTH = {"restitution.ball": 0.72, "friction.ball": 0.2, "gravity": 9.5 / 9.81}  #: of pymunk's world
UNKNOWN = ("friction", "restitution", "gravity")  #: what the scene's author says to have guessed
TRANSITIONS = 100  #: of a recorded throw
SEED = 6000  #: first seed of the logs; settings were chosen looking at others


@dataclass(frozen=True)
class Fitted:
    """Parameters (np,), as many sets that explain the log about as well (K, np), and what it took [s]."""

    theta: Array
    draws: Array
    wall: float
    cpu: float
    recording: float


def hard_model(task: str) -> ComplementarityModel:
    """The task's model before any fit, hard, on one thread."""
    return nominal_model(load_task(task), smoothing=Exact())


def known(task: str) -> Array:
    """The parameters (np,) of the real system."""
    model = hard_model(task)
    truth = TRUTH | ({"restitution.ball": 0.0} if task == "ball_slide" else {})
    return np.array([truth.get(p.name, x) for p, x in zip(model.scene.parameters, model.parameters, strict=True)])


def fits(task: str, throws: tuple[int, ...], draws: int, seed: int) -> list[dict[str, Any]]:
    """A fit of each number of throws, a smaller log the beginning of a larger one; plain data of :class:`Fitted`."""
    begin = time.process_time()
    log = load_task(task).record(max(throws) * TRANSITIONS, seed=SEED + seed)
    recording = time.process_time() - begin
    return [_fit(task, _first(log, count), draws, seed, recording) for count in throws]


def _fit(task: str, log: Transitions, draws: int, seed: int, recording: float) -> dict[str, Any]:
    wall, cpu = time.perf_counter(), time.process_time()
    found = fit(hard_model(task), log, seed=seed, groups=UNKNOWN)
    return {
        "theta": found.model.parameters.tolist(), "draws": found.draws(draws, seed).tolist(),
        "wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu, "recording": recording,
    }  # fmt: skip


def _first(log: Transitions, throws: int) -> Transitions:
    return log.select(np.arange(len(log)) < throws * TRANSITIONS)


def fitted(plain: dict[str, Any]) -> Fitted:
    """From plain data."""
    return Fitted(np.array(plain["theta"]), np.array(plain["draws"]), plain["wall"], plain["cpu"], plain["recording"])
