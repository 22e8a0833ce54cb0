"""What a policy is worth: whole episodes in the real system or in a model, without noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from cmbrl.envs.mdp import MDP
from cmbrl.envs.simulation import Disturbance, Simulation
from cmbrl.envs.system import SystemFactory
from cmbrl.models.protocol import Model

Actor = Callable[[Tensor], Tensor]  #: observations (B, n_o) float32 -> actions (B, n_a) in [-1, 1]


@dataclass(frozen=True)
class Evaluation:
    """Undiscounted returns (E,) without shaping, and lengths (E,) in steps, of as many episodes.

    ``q``, ``v``, ``u``: per episode the states (T + 1, nq), (T + 1, nv) and controls (T, nu), where kept.
    """

    returns: np.ndarray
    lengths: np.ndarray
    q: list[np.ndarray] = field(default_factory=list)
    v: list[np.ndarray] = field(default_factory=list)
    u: list[np.ndarray] = field(default_factory=list)

    def __str__(self) -> str:
        return f"return {self.returns.mean():.1f} +- {self.returns.std():.1f}, length {self.lengths.mean():.0f}"


@torch.no_grad()
def evaluate_real(
    actor: Actor, mdp: MDP, system: SystemFactory, episodes: int, seed: int = 0, keep: bool = False
) -> Evaluation:
    """Episodes of the deterministic policy in the real system; the same seed starts from the same states."""
    q, v = mdp.reset(episodes, torch.Generator().manual_seed(seed))
    robots = [system() for _ in range(episodes)]
    running = np.ones(episodes, dtype=bool)
    returns, lengths = np.zeros(episodes), np.zeros(episodes, dtype=int)
    states = zip(q.numpy().copy(), v.numpy().copy(), strict=True)  # q and v are overwritten below
    history: list[list[tuple[np.ndarray, ...]]] = [[state] for state in states]
    started = False
    for _ in range(mdp.episode_steps):
        rows = np.flatnonzero(running)
        action = actor(mdp.observe(q[rows], v[rows]).float()).double()
        before_q, before_v, u = mdp.act(q[rows], v[rows], action)
        after = []
        for k, row in enumerate(rows):
            if not started or not (torch.equal(before_q[k], q[row]) and torch.equal(before_v[k], v[row])):
                robots[row].reset(before_q[k].numpy(), before_v[k].numpy())
            for _ in range(mdp.repeat):
                state = robots[row].step(u[k].numpy())
                if keep:
                    history[row].append((*state, u[k].numpy()))
            after.append(state)
        started = True
        q_next, v_next = (torch.from_numpy(np.stack(x)) for x in zip(*after, strict=True))
        returns[rows] += mdp.reward(q[rows], v[rows], action, q_next, v_next).numpy()
        lengths[rows] += 1
        running[rows[mdp.terminated(q_next, v_next).numpy()]] = False
        q[rows], v[rows] = q_next, v_next
        if not running.any():
            break
    if not keep:
        return Evaluation(returns, lengths)
    columns = [[np.stack([row[k] for row in rows if len(row) > k]) for rows in history] for k in range(3)]
    return Evaluation(returns, lengths, *columns)


@torch.no_grad()
def evaluate_model(
    actor: Actor, mdp: MDP, model: Model, episodes: int, seed: int = 0, disturbance: Disturbance | None = None
) -> Evaluation:
    """Episodes of the deterministic policy in a model, all in one batch, under ``disturbance`` if given."""
    simulation = Simulation(mdp, model, episodes, seed, disturbance)
    running = torch.ones(episodes, dtype=torch.bool)
    returns, lengths = torch.zeros(episodes, dtype=torch.float64), torch.zeros(episodes)
    for _ in range(mdp.episode_steps):
        observation = simulation.observe()
        step = simulation.step(observation, actor(observation.float()).double())
        returns += torch.where(running, step.reward.nan_to_num(), 0.0)
        lengths += running
        running &= ~(step.terminated | step.truncated)
        if not running.any():
            break
    return Evaluation(returns.numpy(), lengths.numpy().astype(int))
