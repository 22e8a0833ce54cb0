"""Times of one update of SHAC, of its parts, and of MuJoCo simulating as many control steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from cmbrl.bench.timing import Spread, Work, interleaved
from cmbrl.contact.smoothing import Relaxed
from cmbrl.envs.simulation import Simulation
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.system import System
from cmbrl.train.shac import SHAC, SHACConfig

ENVIRONMENTS, HORIZON = 64, 32


def measure(scene: str, warm: int, repeats: int, seed: int) -> dict[str, Any]:
    """Milliseconds of every part for the task ``scene``, and the ratio of MuJoCo's to an update's, turn by turn.

    The clock runs after ``warm`` updates, when robots stand and stumble as in training.
    """
    task = load_task(scene)
    assert task.mdp is not None
    assert task.system is not None
    model = ComplementarityModel(task.load_scene(), smoothing=Relaxed(task.smoothing_speed), **task.model_options())
    config = SHACConfig(environments=ENVIRONMENTS, horizon=HORIZON, variance_every=10**9)
    system, mdp = task.system(), task.mdp()
    trainer = SHAC(mdp, model, config, seed)
    for _ in range(warm):
        trainer.update()
    steps: list[Any] = []

    def rollout() -> None:
        steps[:] = trainer.roll(0.0)
        trainer.policy.net.zero_grad()
        trainer.loss(steps).backward()

    work: Work = {
        "update": (trainer.update, 1),
        "rollout": (rollout, 1),
        "critic": (lambda: trainer.critic.fit(steps), 1),
        "core": (lambda: _core(trainer.simulation), 1),
        "mujoco": (lambda: _mujoco(system, mdp, ENVIRONMENTS * HORIZON), 1),
    }
    seconds = interleaved(work, repeats)
    ratio = float(np.median(seconds["mujoco"] / seconds["update"]))
    return {"task": scene, "ms": {name: Spread.of(1e3 * values) for name, values in seconds.items()}, "ratio": ratio}


def _core(simulation: Simulation) -> None:
    """As many model steps as a window has, from its last states with random controls, forwards and backwards."""
    simulation.detach()
    q, v = simulation.q.requires_grad_(), simulation.v.requires_grad_()
    total = torch.zeros((), dtype=q.dtype)
    for _ in range(HORIZON):
        u = 2 * torch.rand(len(q), simulation.mdp.actions, dtype=q.dtype) - 1
        q_next, v_next = simulation.model.step(q, v, u)
        total = total + q_next.sum() + v_next.sum()
    torch.autograd.grad(total, (q, v))


def _mujoco(system: System, mdp: MDP, count: int) -> None:
    """Random actions, restarted where the task ends the episode (checked every 20 steps)."""
    rng = np.random.default_rng(0)
    q, v = (x[0].numpy() for x in mdp.reset(1, torch.Generator().manual_seed(0)))
    system.reset(q, v)
    for k in range(count):
        after = system.step(rng.uniform(-1, 1, mdp.actions))
        if k % 20 == 19 and mdp.terminated(*(torch.from_numpy(x)[None] for x in after)):
            system.reset(q, v)
