"""One run of the comparison on a known scene: one task, one estimator, one seed, so many seconds of processor time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.estimators.arms import ARMS
from cmbrl.bench.studies.estimators.learning import Learning
from cmbrl.envs.evaluation import evaluate_model
from cmbrl.envs.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import failures
from cmbrl.registry import load_task
from cmbrl.train.recipe import configure
from cmbrl.train.trainer import Diverged

EVALUATION_SEED = 1_000_000
Outcome = dict[str, Any]


def _learning() -> dict[str, Learning]:
    return {
        "hopper": Learning(samples=32, discount=0.98, search=configure("ars", load_task("hopper"))),
        "cheetah": Learning(
            horizon=10, discount=0.99, episode_steps=200, search=configure("ars", load_task("cheetah"))
        ),
    }


@dataclass(frozen=True)
class Work:
    """Sizes. ``seconds``: processor time of a run by task, evaluations not counted."""

    seconds: Mapping[str, float] = field(default_factory=lambda: {"hopper": 24.0, "cheetah": 10.0})
    learning: Mapping[str, Learning] = field(default_factory=_learning)
    contenders: tuple[str, ...] = tuple(ARMS)
    seeds: int = 3
    marks: int = 6  #: evaluations along a run
    episodes: int = 4  #: of each of them
    final_episodes: int = 16
    probe_updates: int = 60  #: of the policy at which gradients are judged
    probe_samples: int = 512  #: windows that each estimate is made of, and that it is judged on


QUICK = Work(
    seconds={"hopper": 1.0, "cheetah": 1.0}, seeds=1, marks=2, episodes=2, final_episodes=2, probe_updates=5,
    probe_samples=64,
)  # fmt: skip


def nominal(name: str) -> tuple[MDP, ComplementarityModel]:
    """The task and its nominal model, hard, on one thread."""
    task = load_task(name)
    assert task.mdp is not None
    return task.mdp(), ComplementarityModel(task.load_scene(), **task.model_options())


def cell(folder: Path, task: str, name: str, seed: int, work: Work) -> Outcome:
    """The outcome of :func:`train`, from its file in ``folder`` if it is there."""
    learning, contender = work.learning[task], ARMS[name]
    key = {"task": task, "contender": asdict(contender), "seed": seed, "seconds": work.seconds[task],
           "learning": asdict(learning), "marks": work.marks,
           "episodes": [work.episodes, work.final_episodes]}  # fmt: skip
    file = folder / f"{task}_{name}_{seed}.json".replace(" ", "_")
    return kept(file, _plain(key), lambda: train(task, name, seed, work))


def train(task: str, name: str, seed: int, work: Work) -> Outcome:
    """Learns until its seconds are spent; rates and noise fall with the share of them, not with updates.

    ``curve``: {"seconds", "steps", "updates", "return"} of the policy without noise in the hard model, from before the
    first update; ``returns``: the final policy's; ``unusable``: updates without a finite gradient.
    """
    mdp, hard = nominal(task)
    trainer = ARMS[name].trainer(mdp, hard, work.learning[task], seed)
    budget, spent, steps = work.seconds[task], 0.0, 0.0
    noises: list[float] = []
    unusable, diverged = 0, ""
    curve: list[dict[str, float]] = []

    def mark() -> None:
        curve.append({"seconds": spent, "steps": steps, "updates": trainer.iteration,
                      "return": _returns(trainer.policy, mdp, hard, work.episodes).mean()})  # fmt: skip

    mark()
    while spent < budget and not diverged:
        begin = time.process_time()
        try:
            metrics = trainer.update()
        except Diverged as error:
            metrics, diverged = {}, str(error)
        spent += time.process_time() - begin
        trainer.config = replace(trainer.config, iterations=math.ceil((trainer.iteration + 1) * budget / spent))
        steps = metrics.get("steps", steps)
        norm, variance = metrics.get("gradient_norm", 1.0), metrics.get("gradient_variance")
        unusable += not math.isfinite(norm)
        if variance is not None and math.isfinite(variance) and 0 < norm < math.inf:
            noises.append(math.sqrt(variance / work.learning[task].samples) / norm)
        if spent >= len(curve) * budget / work.marks or diverged:
            mark()
    return {
        "task": task, "contender": name, "seed": seed, "curve": curve, "diverged": diverged, "unusable": unusable,
        "returns": _returns(trainer.policy, mdp, hard, work.final_episodes).tolist(), "updates": trainer.iteration,
        "steps": steps, "seconds": spent, "noise": float(np.median(noises)) if noises else None,
        "unsolved": failures(trainer.model),
    }  # fmt: skip


def _returns(policy: Callable[..., Any], mdp: MDP, hard: ComplementarityModel, episodes: int) -> np.ndarray:
    return evaluate_model(policy, mdp, hard, episodes, EVALUATION_SEED).returns


def _plain(key: Any) -> Any:
    """Tuples as lists, as JSON gives them back."""
    if isinstance(key, dict):
        return {k: _plain(v) for k, v in key.items()}
    return [_plain(v) for v in key] if isinstance(key, list | tuple) else key
