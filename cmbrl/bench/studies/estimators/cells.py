"""The training job: one task, one estimator, one seed, for a given processor time on a known scene."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cmbrl.bench.studies.estimators.arms import ARMS
from cmbrl.bench.studies.estimators.learning import Learning, nominal
from cmbrl.envs.evaluation import evaluate_model
from cmbrl.models.protocol import failures
from cmbrl.train.trainer import Diverged

EVALUATION_SEED = 1_000_000
LEARNING = {
    "hopper": Learning(samples=32, discount=0.98),
    "cheetah": Learning(horizon=10, discount=0.99, episode_steps=200),
}  #: task -> sizes
Outcome = dict[str, Any]


@dataclass(frozen=True)
class Budget:
    """Length of a run in processor time, evaluations excluded, and how it is evaluated."""

    seconds: float
    marks: int = 6  #: evaluations along a run
    episodes: int = 4  #: of each of them
    final_episodes: int = 16


@dataclass(frozen=True)
class Work:
    """Sizes of the study."""

    budgets: Mapping[str, Budget] = field(default_factory=lambda: {"hopper": Budget(24.0), "cheetah": Budget(10.0)})
    learning: Mapping[str, Learning] = field(default_factory=lambda: LEARNING)
    arms: tuple[str, ...] = tuple(ARMS)
    seeds: int = 3
    probe_updates: int = 60  #: of the policy at which gradients are judged
    probe_samples: int = 512  #: windows that each estimate is made of, and that it is judged on


QUICK = Work(dict.fromkeys(LEARNING, Budget(1.0, 2, 2, 2)), seeds=1, probe_updates=5, probe_samples=64)


def train(task: str, arm: str, seed: int, learning: Learning, budget: Budget) -> Outcome:
    """Learns until the seconds are spent; rates and noise fall with the share of them, not with updates.

    ``curve``: {"seconds", "steps", "updates", "return"} of the policy without noise in the hard model, from before the
    first update; ``returns``: of the final policy; ``noise``: standard error of the gradient relative to its norm,
    median over updates; ``unusable``: updates without a finite gradient; ``unsolved``: failed contact solves.
    """
    mdp, hard = nominal(task)
    trainer = ARMS[arm].trainer(task, learning, seed)
    spent, steps, unusable, diverged = 0.0, 0.0, 0, ""
    noises: list[float] = []
    curve: list[dict[str, float]] = []

    def returns(episodes: int) -> np.ndarray:
        return evaluate_model(trainer.policy, mdp, hard, episodes, EVALUATION_SEED).returns

    def mark() -> None:
        value = float(returns(budget.episodes).mean())
        curve.append({"seconds": spent, "steps": steps, "updates": trainer.iteration, "return": value})

    mark()
    while spent < budget.seconds and not diverged:
        begin = time.process_time()
        try:
            metrics = trainer.update()
        except Diverged as error:
            metrics, diverged = {}, str(error)
        spent += time.process_time() - begin
        updates = math.ceil((trainer.iteration + 1) * budget.seconds / spent)
        trainer.config = replace(trainer.config, iterations=updates)
        steps = metrics.get("steps", steps)
        norm, variance = metrics.get("gradient_norm", 1.0), metrics.get("gradient_variance")
        unusable += not math.isfinite(norm)
        if variance is not None and math.isfinite(variance) and 0 < norm < math.inf:
            noises.append(math.sqrt(variance / learning.samples) / norm)
        if spent >= len(curve) * budget.seconds / budget.marks or diverged:
            mark()
    return {
        "task": task, "arm": arm, "seed": seed, "curve": curve, "diverged": diverged, "unusable": unusable,
        "returns": returns(budget.final_episodes), "updates": trainer.iteration, "steps": steps, "seconds": spent,
        "noise": float(np.median(noises)) if noises else None, "unsolved": failures(trainer.model),
    }  # fmt: skip
