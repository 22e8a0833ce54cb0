"""One training run: a curve of real returns, what training cost, and what the last policy is worth.

The clocks stop while a policy is judged. A run that diverges is a result too: it says so, and its last policy is judged
like any other if it can still act.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from cmbrl.data.transitions import Transitions
from cmbrl.envs.disturbance import Disturbance, parameter_sets
from cmbrl.envs.evaluation import Actor, Evaluation, evaluate_model, evaluate_real
from cmbrl.envs.recording import Recording
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import nominal_model
from cmbrl.models.protocol import Model
from cmbrl.registry import Task, load_task
from cmbrl.system import SystemFactory
from cmbrl.train.loop import EPISODE_STEPS
from cmbrl.train.policies.policy import observed_by

EPISODES, CURVE_EPISODES = 10, 3  #: of the last policy in each system; of one point of the curve
EPISODE_SEED, CURVE_SEED = 9_000, 7_000  #: the same starts for every policy
NOISE_LINEAR, NOISE_ANGULAR, SPREAD = 0.03, 0.1, 0.2  #: of disturbed episodes: m/s, rad/s, share of each parameter
Result = dict[str, Any]


@dataclass(frozen=True)
class Work:
    """Sizes of the study; the mappings at the end change settings of algorithms."""

    transitions: int = 1000  #: of the random log that a seed's arms share
    seconds: Mapping[str, float] = field(default_factory=lambda: {"hopper": 420.0, "cheetah": 150.0})
    """scene -> processor time of a run without an end of its own, about what the loop takes there"""
    points: int = 8  #: of a curve
    ensemble_updates: int = 2000  #: of the ensemble that SHAC trains on
    neural_iterations: int = 1200  #: of SHAC on it, at most: on the hopper the time of one of the loop's policies
    loop: Mapping[str, Any] = field(default_factory=dict)  #: of the loop and of SHAC
    mbpo: Mapping[str, Any] = field(default_factory=dict)
    sac: Mapping[str, Any] = field(default_factory=dict)
    ppo: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Setup:
    """What an arm is given: a task, its nominal model, the seed's random log (None: it collects its own)."""

    task: Task
    mdp: MDP
    system: SystemFactory
    nominal: ComplementarityModel
    work: Work
    seed: int
    log: Transitions | None

    @classmethod
    def of(cls, scene: str, seed: int, work: Work, takes_log: bool) -> Setup:
        """That of a task by name."""
        task = load_task(scene)
        assert task.mdp is not None
        assert task.system is not None
        mdp = task.mdp()
        log = random_log(mdp, task.system, work.transitions, seed) if takes_log else None
        return cls(task, mdp, task.system, nominal_model(task, threads=1), work, seed, log)

    def judge(self, policy: Actor, model: Model | None) -> Result:
        """Episodes in the real system, in the ``model`` that the policy was trained on (None: none), and disturbed.

        Disturbed, for all arms alike: in the nominal model with noise on every velocity and varied parameters.
        """
        varied = parameter_sets(self.nominal, SPREAD, seed=EPISODE_SEED)
        noise, mdp = Disturbance(NOISE_LINEAR, NOISE_ANGULAR, varied), observed_by(policy, self.mdp)
        return {
            "real": _told(evaluate_real(policy, mdp, self.system, EPISODES, EPISODE_SEED)),
            "model": None if model is None else _told(evaluate_model(policy, mdp, model, EPISODES, EPISODE_SEED)),
            "disturbed": _told(evaluate_model(policy, mdp, self.nominal, EPISODES, EPISODE_SEED, noise)),
        }


class Training:
    """A run in progress: ``costs`` so far, the ``curve``, and what ended it early (``failed``).

    It has ``iterations``, or if that is None, no new update after the processor time that the study gives a scene.
    """

    def __init__(self, setup: Setup, iterations: int | None) -> None:
        self.setup, self.iterations = setup, iterations
        known = 0 if setup.log is None else len(setup.log)
        self.costs: Result = {"iteration": 0, "cpu": 0.0, "wall": 0.0, "transitions": known, "steps": 0}
        self.curve: list[Result] = []
        self.failed: str | None = None
        self.trainer: Any = None

    def run(self, make: Callable[[Setup], Any]) -> Training:
        """Trains to the end. ``make`` is called on the clock, because it may fit a model; a UserError ends the run."""
        try:
            self.trainer = self._clocked(lambda: make(self.setup))
            while self.costs["iteration"] == 0 or self.share() < 1.0:  # making it may take a short run's seconds
                metrics = self._clocked(self.trainer.update)
                self.costs |= {key: int(metrics[key]) for key in ("transitions", "steps") if key in metrics}
                self.costs["iteration"] += 1
                if self.share() * self.setup.work.points >= len(self.curve) + 1 - 1e-9:
                    setup, policy = self.setup, self.trainer.policy
                    mdp = observed_by(policy, setup.mdp)
                    judged = evaluate_real(policy, mdp, setup.system, CURVE_EPISODES, CURVE_SEED)
                    self.curve.append({**self.costs, "real": _number(judged.returns.mean())})
        except UserError as error:  # Diverged is one
            self.failed = str(error)
        return self

    def share(self) -> float:
        """Share of the run that is done."""
        if self.iterations is None:
            return min(1.0, float(self.costs["cpu"]) / self.setup.work.seconds[self.setup.task.name])
        return min(1.0, float(self.costs["iteration"]) / (self.iterations + self.trainer.further))

    def result(self, modelled: bool) -> Result:
        """Plain data of the run; ``modelled``: the policy is also judged in ``trainer.model``."""
        found = {**self.costs, "failed": self.failed, "curve": self.curve}
        if self.trainer is None or not all(bool(x.isfinite().all()) for x in self.trainer.policy.parameters()):
            return found
        return found | self.setup.judge(self.trainer.policy, self.trainer.model if modelled else None)

    def _clocked(self, work: Callable[[], Any]) -> Any:
        cpu, wall = time.process_time(), time.perf_counter()
        try:
            return work()
        finally:
            self.costs["cpu"] += time.process_time() - cpu
            self.costs["wall"] += time.perf_counter() - wall


def random_log(mdp: MDP, system: SystemFactory, transitions: int, seed: int) -> Transitions:
    """What a loop of this ``seed`` records in its first round: random actions, episodes of at most 200 steps."""
    short = replace(mdp, episode_steps=min(mdp.episode_steps, EPISODE_STEPS))
    recording, generator = Recording(short, system, seed), torch.Generator().manual_seed(seed)
    while recording.transitions < transitions:
        recording.step(2 * torch.rand((1, mdp.actions), generator=generator, dtype=torch.float64) - 1)
    return recording.log()


def _told(judged: Evaluation) -> Result:
    return {"returns": [_number(x) for x in judged.returns], "lengths": [int(n) for n in judged.lengths]}


def _number(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None
