"""Where gradients over long horizons are tried: rigid contact, the soft contact of MJCF files, chaotic starts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from cmbrl.gradients import Rollout, TanhPolicy
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import Model
from cmbrl.registry import Task, load_task
from cmbrl.scene import Scene

ROOT = 2  #: coordinates of the torso's position, which come first


@cache
def task_of(name: str) -> tuple[Task, MDP]:
    """The task and its decision process, looked up once."""
    task = load_task(name)
    assert task.mdp is not None
    return task, task.mdp()


@dataclass(frozen=True)
class Situation:
    """A robot under a linear policy followed by a tanh, from random starts.

    ``speed``: standard deviation of every angular velocity at the start [rad/s], on top of the task's own reset.
    """

    title: str
    task: str
    law: str  #: contact law: "mujoco" (softness as in the MJCF) or "rigid"
    height: float  #: best height of the torso, in the root's coordinate [m]
    speed: float

    def model(self) -> ComplementarityModel:
        """The nominal model, simulated and differentiated hard."""
        task, _ = task_of(self.task)
        scene = Scene.from_mjcf(task.scene_path, contact_law=self.law)
        return ComplementarityModel(scene, **task.model_options())

    def policy(self) -> TanhPolicy:
        """From the task's observation, with velocities scaled by 0.1, to controls."""
        task, mdp = task_of(self.task)
        scale = torch.ones(mdp.observations, dtype=torch.float64)
        scale[-task.load_scene().nv :] = 0.1
        return TanhPolicy(lambda q, v: scale * mdp.observe(q, v), mdp.observations, mdp.actions)

    def start(self, seed: int) -> np.ndarray:
        """Weights (n,) of the first policy, so small that it hardly acts."""
        return 0.1 * np.random.default_rng(seed).normal(size=self.policy().size)

    def rollout(self, model: Model, policy: TanhPolicy, horizon: int, count: int, seed: int) -> Rollout:
        """``count`` episodes; starts depend on the seed only."""
        _, mdp = task_of(self.task)
        generator = torch.Generator().manual_seed(seed)
        q, v = mdp.reset(count, generator)
        v[:, ROOT:] += self.speed * torch.randn(v[:, ROOT:].shape, generator=generator, dtype=v.dtype)
        return Rollout(model, policy, self.reward, horizon, q, v)

    def reward(self, u: Tensor, q: Tensor, v: Tensor) -> Tensor:
        """(B,): distance forward [m] minus costs of tilt and of the wrong height; no episode ends early."""
        return task_of(self.task)[0].control_dt * (v[:, 0] - q[:, 2].square() - 4 * (q[:, 1] - self.height).square())


SITUATIONS = {
    "stiff": Situation("hopper, rigid contact", "hopper", "rigid", 1.25, 0.3),
    "soft": Situation("hopper, softness of its MJCF", "hopper", "mujoco", 1.25, 0.3),
    "chaotic": Situation("half-cheetah, limbs flung at 4 rad/s", "cheetah", "mujoco", 0.0, 4.0),
}
