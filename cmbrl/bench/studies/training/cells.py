"""Times of one update of SHAC, of its parts, and of MuJoCo simulating as many control steps."""

from __future__ import annotations

import resource
import time
from typing import Any

import numpy as np
import torch

from cmbrl.bench.timing import Spread, Work, interleaved
from cmbrl.envs.of_task import real_system
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.system import System
from cmbrl.train.models import load_model
from cmbrl.train.setup import set_up
from cmbrl.train.shac import SHAC

ENVIRONMENTS, HORIZON = 64, 32
GIB = 2**20  # of the kilobytes in which the system counts


def measure(task: str, derivative: str | None, warm: int, repeats: int, threads: int, seed: int) -> dict[str, Any]:
    """Milliseconds of every part for ``task``, and the ratio of MuJoCo's to an update's, turn by turn.

    The clock runs after ``warm`` updates, when robots stand and stumble as in training. ``threads`` are the core's; on
    one thread processor time counts, on several the wall clock. The rest takes one thread in any case.
    """
    size = {"environments": ENVIRONMENTS, "horizon": HORIZON, "variance_every": 10**9}
    settings = {name: str(value) for name, value in size.items()}
    setup = set_up(task, "shac", "nominal", settings, derivative=derivative, seed=seed, threads=threads)
    trainer = setup.trainer()
    assert isinstance(trainer, SHAC)
    model = load_model("nominal", setup.task, threads=threads)
    assert isinstance(model, ComplementarityModel)
    for _ in range(warm):
        trainer.update()
    steps: list[Any] = []
    system, begin, controls = real_system(setup.task)(), _start(trainer), _controls(trainer)

    def rollout() -> None:
        steps[:] = trainer.roll(0.0)
        trainer.policy.net.zero_grad()
        trainer.loss(steps).backward()

    work: Work = {
        "update": (trainer.update, 1),
        "rollout": (rollout, 1),
        "critic": (lambda: trainer.critic.fit(steps), 1),
        "core": (lambda: _core(model, trainer, controls), 1),
    }
    if threads == 1:
        work["mujoco"] = (lambda: _mujoco(system, begin, controls), 1)
    seconds = interleaved(work, repeats, time.thread_time if threads == 1 else time.perf_counter)
    ratio = float(np.median(seconds["mujoco"] / seconds["update"])) if threads == 1 else None
    before = model_steps(trainer)
    trainer.update()
    return {
        "task": task,
        "derivative": derivative or "",
        "ms": {name: Spread.of(1e3 * values) for name, values in seconds.items()},
        "ratio": ratio,
        "steps": model_steps(trainer) - before,
        "gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / GIB,
    }


def model_steps(trainer: SHAC) -> int:
    """Control steps of the model so far, with those of branches."""
    counted: int = getattr(trainer.model, "steps", trainer.simulation.steps_taken)
    return counted


def _start(trainer: SHAC) -> tuple[np.ndarray, np.ndarray]:
    q, v = trainer.mdp.reset(1, torch.Generator().manual_seed(0))
    return trainer.mdp.robot(q)[0].numpy(), v[0].numpy()


def _controls(trainer: SHAC) -> torch.Tensor:
    """Random controls (HORIZON, ENVIRONMENTS, nu) at the trainer's states."""
    simulation, mdp = trainer.simulation, trainer.mdp
    simulation.detach()
    draw = torch.Generator().manual_seed(0)
    shape = HORIZON, ENVIRONMENTS, mdp.actions
    actions = 2 * torch.rand(shape, generator=draw, dtype=torch.float64) - 1
    return torch.stack([mdp.act(simulation.q, simulation.v, action)[2] for action in actions])


def _core(model: ComplementarityModel, trainer: SHAC, controls: torch.Tensor) -> None:
    """As many model steps as a window has, from its last states with random controls, forwards and backwards."""
    simulation = trainer.simulation
    simulation.detach()
    q = trainer.mdp.robot(simulation.q).clone().requires_grad_()
    v = simulation.v.clone().requires_grad_()
    q_next, v_next = q, v
    total = torch.zeros((), dtype=q.dtype)
    for u in controls:
        q_next, v_next = model.step(q_next, v_next, u)
        total = total + q_next.sum() + v_next.sum()
    torch.autograd.grad(total, (q, v))


def _mujoco(system: System, begin: tuple[np.ndarray, np.ndarray], controls: torch.Tensor) -> None:
    """The same number of control steps, restarted every HORIZON of them."""
    for k in range(controls.shape[1]):
        system.reset(*begin)
        for u in controls[:, k].numpy():
            system.step(u)
