"""Returns of a policy: whole episodes in the real system or in a model, without noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from cmbrl.envs.disturbance import Disturbance
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model
from cmbrl.system import SystemFactory

Actor = Callable[[Tensor], Tensor]  #: observations (B, n_o) float32 -> actions (B, n_a) in [-1, 1]


@dataclass(frozen=True)
class Evaluation:
    """Undiscounted returns (E,) without shaping, lengths (E,) in steps, and whether each was ``terminated`` (E,).

    ``info``: the mean of each number of ``MDP.info`` over the steps of an episode (E,), by name. ``q``, ``v``, ``u``:
    per episode the states (T + 1, nq), (T + 1, nv) and controls (T, nu), if kept.
    """

    returns: np.ndarray
    lengths: np.ndarray
    terminated: np.ndarray
    info: dict[str, np.ndarray] = field(default_factory=dict)
    q: list[np.ndarray] = field(default_factory=list)
    v: list[np.ndarray] = field(default_factory=list)
    u: list[np.ndarray] = field(default_factory=list)

    def __str__(self) -> str:
        return f"return {self.returns.mean():.1f} +- {self.returns.std():.1f}, length {self.lengths.mean():.0f}"


@torch.no_grad()
def evaluate_real(
    actor: Actor, mdp: MDP, system: SystemFactory, episodes: int, seed: int = 0, keep: bool = False
) -> Evaluation:
    """Episodes of the deterministic policy in the real system; the same seed starts from the same states.

    An episode whose state is not finite ends there, as in a model; that step earns nothing if its reward is not finite.
    """
    q, v = mdp.reset(episodes, torch.Generator().manual_seed(seed))
    robots = SystemBatch(system, episodes)
    returns, lengths, ended = np.zeros(episodes), np.zeros(episodes, dtype=int), np.zeros(episodes, dtype=bool)
    told: dict[str, np.ndarray] = {}
    history: list[list[tuple[np.ndarray, ...]]] = [
        [state] for state in zip(mdp.robot(q).numpy(), v.numpy(), strict=True)
    ]
    running = np.arange(episodes)
    for _ in range(mdp.episode_steps):
        action = actor(mdp.observe(q, v).float()).double()
        q_next, v_next, u = mdp.act(q, v, action)
        for _ in range(mdp.repeat):
            q_next, v_next = mdp.move(robots.step, q_next, v_next, u, running.tolist())
            if keep:
                for k, *row in zip(running, mdp.robot(q_next).numpy(), v_next.numpy(), u.numpy(), strict=True):
                    history[k].append(tuple(row))
        reward, info = mdp.score(q, v, action, q_next, v_next)
        returns[running] += reward.nan_to_num().numpy()
        lengths[running] += 1
        for name, value in info.items():
            told.setdefault(name, np.zeros(episodes))[running] += value.nan_to_num().numpy()
        finite = torch.isfinite(q_next).all(dim=1) & torch.isfinite(v_next).all(dim=1)
        goes_on = finite & ~mdp.terminated(q_next, v_next)
        ended[running] = ~goes_on.numpy()
        goes_on &= ~torch.as_tensor(mdp.out_of_time(q_next, v_next, 0))
        running, q, v = running[goes_on.numpy()], q_next[goes_on], v_next[goes_on]
        if not len(running):
            break
    means = {name: total / lengths for name, total in told.items()}
    if not keep:
        return Evaluation(returns, lengths, ended, means)
    columns = [[np.stack([row[k] for row in rows if len(row) > k]) for rows in history] for k in range(3)]
    return Evaluation(returns, lengths, ended, means, *columns)


@torch.no_grad()
def evaluate_model(
    actor: Actor,
    mdp: MDP,
    model: Model,
    episodes: int,
    seed: int = 0,
    disturbance: Disturbance | None = None,
    tell: bool = True,
) -> Evaluation:
    """Episodes of the deterministic policy in a model, all in one batch, under ``disturbance`` if given.

    An episode whose state is not finite ends there. ``tell``: with the process's ``info``.
    """
    simulation = Simulation(mdp, model, episodes, seed, disturbance, tell=tell)
    running = torch.ones(episodes, dtype=torch.bool)
    returns, lengths = torch.zeros(episodes, dtype=torch.float64), torch.zeros(episodes)
    ended = torch.zeros(episodes, dtype=torch.bool)
    told: dict[str, Tensor] = {}
    for _ in range(mdp.episode_steps):
        observation = simulation.observe()
        step = simulation.step(observation, actor(observation.float()).double())
        returns += torch.where(running, step.reward.nan_to_num(), 0.0)
        lengths += running
        for name, value in step.info.items():
            told[name] = told.get(name, torch.zeros(())) + torch.where(running, value.nan_to_num(), 0.0)
        ended |= running & step.terminated
        running &= ~(step.terminated | step.truncated)
        if not running.any():
            break
    means = {name: (total / lengths).numpy() for name, total in told.items()}
    return Evaluation(returns.numpy(), lengths.numpy().astype(int), ended.numpy(), means)
