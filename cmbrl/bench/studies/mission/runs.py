"""One training run as a cell of a study: a curve of real returns, what training cost, what the last policy is worth.

The clocks stand still while a policy is judged. A run that diverges is a result: it says so, and its last policy that
can act is judged as any other.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cmbrl.data.transitions import Transitions
from cmbrl.envs.evaluation import Actor, Evaluation, evaluate_model, evaluate_real
from cmbrl.envs.mdp import MDP
from cmbrl.envs.recording import Recording
from cmbrl.envs.simulation import Disturbance, parameter_sets
from cmbrl.envs.system import SystemFactory
from cmbrl.errors import UserError
from cmbrl.files import read_json
from cmbrl.models.protocol import Model
from cmbrl.registry import Task
from cmbrl.train.checkpoint import load_state
from cmbrl.train.loop import EPISODE_STEPS, Loop
from cmbrl.train.trainer import Trainer

EPISODES, CURVE_EPISODES = 10, 3  # of the last policy, in each system; of one point of the curve
EPISODE_SEED, CURVE_SEED = 9_000, 7_000  # the same starts for every policy
NOISE_LINEAR, NOISE_ANGULAR, SPREAD = 0.03, 0.1, 0.2  # of the disturbed episodes: m/s, rad/s, share of each parameter
Result = dict[str, Any]


@dataclass(frozen=True)
class Contest:
    """Where policies are judged: the process, its real system, and the nominal model to disturb."""

    mdp: MDP
    system: SystemFactory
    nominal: Model

    @classmethod
    def of(cls, task: Task, nominal: Model) -> Contest:
        """That of a task; raises UserError when it has no decision process or no real system."""
        if task.mdp is None or task.system is None:
            raise UserError(f"{task.name}: has no decision process with a real system: choose another scene")
        return cls(task.mdp(), task.system, nominal)


@dataclass(frozen=True)
class Plan:
    """How long a run is: ``iterations`` at most, and ``seconds`` of processor time, after which an update is its last.

    ``points``: of the curve, the end included, evenly over the share of the limit that is nearer.
    """

    iterations: int
    seconds: float = math.inf
    points: int = 8


@dataclass
class Training:
    """A trainer under way: ``make`` is called on the clock, for it may fit a model."""

    contest: Contest
    plan: Plan
    known: int  # real transitions that were given
    cpu: float = 0.0
    wall: float = 0.0
    iteration: int = 0
    curve: list[Result] = field(default_factory=list)
    last: dict[str, float] = field(default_factory=dict)  # metrics
    failed: str | None = None
    trainer: Trainer | None = None

    def run(self, make: Callable[[], Trainer]) -> Training:
        """All of it; whatever a user could have been told ends it early and is noted."""
        try:
            self.trainer = self._clocked(make)
            while self.iteration == 0 or self.share() < 1.0:  # making it may have taken all of a short run's seconds
                self.last = self._clocked(self.trainer.update)
                self.iteration += 1
                if self.share() * self.plan.points >= len(self.curve) + 1 - 1e-9:
                    self.curve.append(self._point(self.trainer))
        except UserError as error:  # Diverged is one
            self.failed = str(error)
        return self

    def share(self) -> float:
        """Of the run that is done."""
        return min(1.0, max(self.iteration / self.plan.iterations, self.cpu / self.plan.seconds))

    def transitions(self) -> int:
        """Real ones so far."""
        return int(self.last.get("transitions", self.known))

    def _clocked(self, work: Callable[[], Any]) -> Any:
        cpu, wall = time.process_time(), time.perf_counter()
        try:
            return work()
        finally:
            self.cpu += time.process_time() - cpu
            self.wall += time.perf_counter() - wall

    def _point(self, trainer: Trainer) -> Result:
        judged = evaluate_real(trainer.policy, self.contest.mdp, self.contest.system, CURVE_EPISODES, CURVE_SEED)
        return {**self._costs(), "real": number(judged.returns.mean())}

    def _costs(self) -> Result:
        return {
            "iteration": self.iteration,
            "cpu": self.cpu,
            "wall": self.wall,
            "transitions": self.transitions(),
            "steps": int(self.last.get("steps", 0)),
        }

    def result(self, model: Callable[[Any], Model] | None) -> Result:
        """Plain data of the run; ``model`` gives the one that a trainer's policy believes in, None without any."""
        found = {**self._costs(), "failed": self.failed, "curve": self.curve}
        if self.trainer is None or not acts(self.trainer):
            return found
        believed = None if model is None else model(self.trainer)
        return found | judge(self.trainer.policy, self.contest, believed)


def judge(policy: Actor, contest: Contest, model: Model | None) -> Result:
    """Episodes of ``policy`` in the real system, in the ``model`` that it was trained on (None: none), and disturbed.

    Disturbed: in the nominal contact model with noise on every velocity and parameters that vary, for all the same.
    """
    mdp, nominal = contest.mdp, contest.nominal
    varied = Disturbance(NOISE_LINEAR, NOISE_ANGULAR, parameter_sets(nominal, SPREAD, seed=EPISODE_SEED))
    return {
        "real": told(evaluate_real(policy, mdp, contest.system, EPISODES, EPISODE_SEED)),
        "model": None if model is None else told(evaluate_model(policy, mdp, model, EPISODES, EPISODE_SEED)),
        "disturbed": told(evaluate_model(policy, mdp, nominal, EPISODES, EPISODE_SEED, varied)),
    }


def finished(folder: Path, loop: Loop, wanted: dict[str, Any], contest: Contest) -> Result:
    """The result of a loop that ``cmbrl train`` ran to its end in ``folder``, as if it had been run here.

    ``loop`` is one made alike, ``wanted`` the options that must have been given. Such a run has one point of a curve,
    its end, and says how much processor time it took only where ``time.json`` says it ({"user": s, "system": s}).
    Raises UserError when it is of another kind, or not finished.
    """
    held, ended = read_json(folder / "config.json"), read_json(folder / "train.json")
    for name, value in wanted.items():
        if held.get(name) != value:
            raise UserError(f"{folder}: was run with {name} {held.get(name)}, not {value}: move it away")
    if ended["stopped"] == "interrupted":
        raise UserError(f"{folder}: is not finished: `cmbrl train --resume` it, or move it away")
    state = load_state(folder / "checkpoint.safetensors")
    if ended["stopped"] == "finished" and state["iteration"] != loop.config.iterations:
        raise UserError(f"{folder}: had {state['iteration']} iterations, not {loop.config.iterations}: move it away")
    loop.restore(state["trainer"])
    clock = read_json(folder / "time.json") if (folder / "time.json").exists() else None
    costs = {
        "iteration": state["iteration"],
        "cpu": clock and clock["user"] + clock["system"],
        "wall": state["seconds"],
        "transitions": int(ended["last"]["transitions"]),
        "steps": int(ended["last"]["steps"]),
    }
    failed = None if ended["stopped"] == "finished" else "diverged"
    result = {**costs, "failed": failed, **judge(loop.policy, contest, loop.model)}
    point = {**costs, "real": number(np.mean([x for x in result["real"]["returns"] if x is not None]))}
    return {**result, "curve": [point]}


def random_log(mdp: MDP, system: SystemFactory, transitions: int, seed: int) -> Transitions:
    """What a loop of this ``seed`` records in its first round: random actions, episodes of at most 200 steps."""
    short = replace(mdp, episode_steps=min(mdp.episode_steps, EPISODE_STEPS))
    recording, generator = Recording(short, system, seed), torch.Generator().manual_seed(seed)
    while recording.transitions < transitions:
        recording.step(2 * torch.rand((1, mdp.actions), generator=generator, dtype=torch.float64) - 1)
    return recording.log()


def acts(trainer: Trainer) -> bool:
    """Whether the policy's weights are numbers."""
    return all(bool(weights.isfinite().all()) for weights in trainer.policy.parameters())


def told(judged: Evaluation) -> Result:
    """Returns and lengths as plain data."""
    return {"returns": [number(x) for x in judged.returns], "lengths": [int(n) for n in judged.lengths]}


def number(x: float) -> float | None:
    """x for JSON, which knows no NaN and no infinity."""
    return float(x) if math.isfinite(x) else None
