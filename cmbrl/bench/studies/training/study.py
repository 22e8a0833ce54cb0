"""``cmbrl bench training``: what an update of a policy costs, beside MuJoCo simulating as many control steps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cmbrl.bench.study import Progress, Section, Settings, Study, Table, with_progress
from cmbrl.bench.timing import Spread, interleaved
from cmbrl.contact import Barrier
from cmbrl.envs.mdp import MDP
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system import System
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.train.shac import SHAC, SHACConfig

LABELS = ("hopper", "cheetah")
ENVIRONMENTS, HORIZON = 64, 32
WARM, QUICK_WARM = 60, 5  #: updates before the clock runs, after which robots stand and stumble as in training
REPEATS, QUICK_REPEATS = 20, 3


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    torch.set_num_threads(1)
    labels = settings.scenes or LABELS
    rows = []
    for k, label in enumerate(labels):
        progress(k / len(labels), label)
        rows.append(_row(label, settings))
    columns = [
        "task", "control steps", "update [ms]", "fastest", "slowest", "rollout and gradient [ms]", "critic [ms]",
        "core alone [ms]", "mj_step alone [ms]", "mj_step / update",
    ]  # fmt: skip
    note = (
        "Processor time of one thread, medians of turns. 'rollout and gradient': 64 episodes of 32 control steps with "
        "policy, noise, reward and the backward pass through all of it; 'core alone': the same steps and their "
        "vector-Jacobian products without policy and reward; 'mj_step alone': MuJoCo simulating as many control steps "
        "with random actions, without any gradient."
    )
    text = "SHAC on the task's nominal model, nets 128-64 (policy) and 64-64 (critic, 8 batches an update)."
    return Section("Training speed", text, [Table("One update", columns, rows, note)], [], {"rows": rows})


def _row(label: str, settings: Settings) -> list[Any]:
    task = load_task(label)
    assert task.mdp is not None
    assert task.system is not None
    model = ComplementarityModel(task.load_scene(), smoothing=Barrier(task.smoothing_kappa), **task.model_options())
    config = SHACConfig(environments=ENVIRONMENTS, horizon=HORIZON, variance_every=10**9)
    system, mdp = task.system(), task.mdp()
    trainer = SHAC(mdp, model, config, settings.seed)
    for _ in range(QUICK_WARM if settings.quick else WARM):
        trainer.update()
    steps: list[Any] = []

    def rollout() -> None:
        steps[:] = trainer.roll(0.0)
        trainer.policy.net.zero_grad()
        trainer.loss(steps).backward()

    work: dict[str, tuple[Callable[[], object], int]] = {
        "update": (trainer.update, 1),
        "rollout": (rollout, 1),
        "critic": (lambda: trainer.critic.fit(steps), 1),
        "core": (lambda: _core(trainer.simulation), 1),
        "mujoco": (lambda: _mujoco(system, mdp, ENVIRONMENTS * HORIZON), 1),
    }
    seconds = interleaved(work, QUICK_REPEATS if settings.quick else REPEATS)
    ms = {name: Spread.of(1e3 * values) for name, values in seconds.items()}
    ratio = float(np.median(seconds["mujoco"] / seconds["update"]))
    return [
        label, ENVIRONMENTS * HORIZON, ms["update"].median, ms["update"].low, ms["update"].high, ms["rollout"].median,
        ms["critic"].median, ms["core"].median, ms["mujoco"].median, ratio,
    ]  # fmt: skip


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
    """Random actions, started anew where the task says that an episode is over (looked at every 20 steps)."""
    rng = np.random.default_rng(0)
    q, v = (x[0].numpy() for x in mdp.reset(1, torch.Generator().manual_seed(0)))
    system.reset(q, v)
    for k in range(count):
        after = system.step(rng.uniform(-1, 1, mdp.actions))
        if k % 20 == 19 and mdp.terminated(*(torch.from_numpy(x)[None] for x in after)):
            system.reset(q, v)


STUDY = Study(
    "training", "one update of a policy beside MuJoCo simulating as many steps", with_progress(_study), LABELS
)
