"""Where gradients over long horizons are tried: hard contact, that of MJCF files, and starts that are chaotic."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from cmbrl.envs.mdp import MDP
from cmbrl.gradients import Rollout, TanhPolicy
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import Model
from cmbrl.registry import Task, load_task
from cmbrl.scene import Scene

ROOT = 2  #: coordinates of the torso's place, which come first


@cache
def task_of(name: str) -> tuple[Task, MDP]:
    """The task and its decision process, looked up once."""
    task = load_task(name)
    assert task.mdp is not None
    return task, task.mdp()


@dataclass(frozen=True)
class Situation:
    """A robot under a linear policy behind a tanh, from random starts. Rewards and starts are our choice.

    ``speed``: standard deviation of every angular velocity at the start [rad/s], on top of the task's own reset.
    """

    title: str
    task: str
    law: str  #: "mujoco" (the softness that the MJCF states) or "rigid"
    height: float  #: of the torso that is worth most, in the root's coordinate [m]
    speed: float

    def model(self) -> ComplementarityModel:
        """The nominal model, simulated and differentiated hard."""
        task, _ = task_of(self.task)
        scene = Scene.from_mjcf(task.scene_path, contact_law=self.law)
        return ComplementarityModel(scene, **task.model_options())

    def policy(self) -> TanhPolicy:
        """Controls of the task's observation, velocities at a tenth."""
        task, mdp = task_of(self.task)
        scale = torch.ones(mdp.observations, dtype=torch.float64)
        scale[-task.load_scene().nv :] = 0.1
        return TanhPolicy(lambda q, v: scale * mdp.observe(q, v), mdp.observations, mdp.actions)

    def start(self, size: int, seed: int) -> np.ndarray:
        """Weights (n,) of the first policy, small: it hardly acts."""
        return 0.1 * np.random.default_rng(seed).normal(size=size)

    def rollout(self, model: Model, policy: TanhPolicy, horizon: int, count: int, seed: int) -> Rollout:
        """``count`` episodes; the same seed has the same starts, whatever the model's derivative is."""
        _, mdp = task_of(self.task)
        generator = torch.Generator().manual_seed(seed)
        q, v = mdp.reset(count, generator)
        v[:, ROOT:] += self.speed * torch.randn(v[:, ROOT:].shape, generator=generator, dtype=v.dtype)
        return Rollout(model, policy, self.reward, horizon, q, v)

    def reward(self, u: Tensor, q: Tensor, v: Tensor) -> Tensor:
        """(B,): forward way [m] less what it costs to tilt or to be at another height; no episode ends early."""
        return task_of(self.task)[0].control_dt * (v[:, 0] - q[:, 2].square() - 4 * (q[:, 1] - self.height).square())


SITUATIONS = {
    "stiff": Situation("hopper, rigid contact", "hopper", "rigid", 1.25, 0.3),
    "soft": Situation("hopper, softness of its MJCF", "hopper", "mujoco", 1.25, 0.3),
    "chaotic": Situation("half-cheetah, limbs flung at 4 rad/s", "cheetah", "mujoco", 0.0, 4.0),
}
