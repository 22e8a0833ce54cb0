"""The jobs of the study: trainings under one softening, tried in the hard scene on the way."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.bench.studies.smoothing.plan import Arm
from cmbrl.bench.studies.smoothing_robots.plan import SCENES, Size
from cmbrl.envs.evaluation import evaluate_model
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.train.setup import set_up
from cmbrl.train.trainer import Diverged
from cmbrl.train.windows.learner import WindowLearner

TRIALS = 9000  #: seed of the starts that every policy is tried from
Outcome = dict[str, Any]


def trained(task: str, arm: Arm, size: Size, seeds: Sequence[int], episodes: int) -> Outcome:
    """Policies of the scene ``task`` by seed, as they are after so many updates.

    ``updates`` (T,), ``returns`` (T, seeds): means of as many ``episodes`` without noise in the hard scene, from the
    same starts. A training that diverges keeps its last policy. ``cpu`` (seeds,) [s]: of the updates alone.
    """
    updates = np.unique(np.linspace(0, size.updates, size.points + 1).round().astype(int))
    runs = [_run(task, arm, size.updates, seed, updates.tolist(), episodes) for seed in seeds]
    return {
        "task": task, "softening": arm.softening, "both": arm.both, "rate": arm.rate, "updates": updates,
        "returns": np.array([returns for returns, _ in runs]).T.round(4), "cpu": [cpu for _, cpu in runs],
    }  # fmt: skip


def costs(task: str, arms: Sequence[Arm], size: Size, seeds: Sequence[int], episodes: int, turns: int) -> list[float]:
    """Processor seconds of an update by each arm: the least of ``turns``, which the arms take one after the other."""
    found = [
        [trained(task, arm, size, seeds[:1], episodes)["cpu"][0] / size.updates for arm in arms] for _ in range(turns)
    ]
    return np.min(found, axis=0).tolist()  # type: ignore[no-any-return]


def _run(
    scene: str, arm: Arm, count: int, seed: int, updates: Sequence[int], episodes: int
) -> tuple[list[float], float]:
    """Returns after ``updates``, and the processor seconds of all of them."""
    learner = learner_of(scene, arm, count, seed)
    hard = nominal_model(load_task(SCENES[scene].task), threads=1)
    returns: list[float] = []
    seconds, alive = 0.0, True
    for k in range(count + 1):
        if k and alive:
            begin = time.process_time()
            try:
                learner.update()
            except Diverged:
                alive = False
            seconds += time.process_time() - begin
        if k in updates:
            returns.append(float(evaluate_model(learner.policy, learner.mdp, hard, episodes, TRIALS).returns.mean()))
    return returns, seconds


def learner_of(scene: str, arm: Arm, updates: int, seed: int) -> WindowLearner:
    """The scene's learner under the arm's softening, which is of the simulation too if it says ``both``."""
    of = SCENES[scene]
    settings = {"iterations": updates, "variance_every": 10**9} if of.algorithm == "shac" else {"iterations": updates}
    settings |= of.settings | {of.rate: arm.rate}
    setup = set_up(
        of.task, of.algorithm, "nominal", {name: str(value) for name, value in settings.items()},
        smoothing=simulated(arm.softening) if arm.both else None, derivative=arm.softening, seed=seed, threads=1,
    )  # fmt: skip
    learner = setup.trainer()
    assert isinstance(learner, WindowLearner)
    return learner


def simulated(softening: str) -> str:
    """The softening of a derivative as one of the simulation, which says how kappa is differentiated by an option."""
    kind, _, options = softening.partition(":")
    return f"gaussian:{options},derivative=stop" if kind == "gaussian-stopped" else softening
