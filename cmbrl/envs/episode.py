"""One episode of a policy from a given state with every configuration, for clips."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from cmbrl.envs.evaluation import Actor
from cmbrl.mdp import MDP
from cmbrl.models.between.robots import Robots
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.models.protocol import Model


@dataclass(frozen=True)
class Episode:
    """Configurations ``q`` (T + 1, nq) every ``dt`` [s], the return so far (T + 1,), and whether it terminated."""

    q: np.ndarray
    returns: np.ndarray
    dt: float
    terminated: bool


@torch.no_grad()
def play_episode(actor: Actor, mdp: MDP, start: tuple[Tensor, Tensor], model: Model, seconds: float) -> Episode:
    """The deterministic policy from ``start`` (q (1, nq), v (1, nv)) for ``seconds``, or until the episode ends.

    For the real system, ``model`` is a :class:`cmbrl.envs.system_batch.SystemBatch` of one. A state that is not finite
    terminates.
    """
    q, v = start
    robot = Robots(model, 1)
    total = 0.0
    shown, returns = [mdp.robot(q)[0].numpy()], [0.0]
    terminated = False
    for _ in range(min(mdp.episode_steps, max(1, round(seconds / mdp.dt)))):
        action = actor(mdp.observe(q, v).float()).double()
        q_next, v_next, u = mdp.act(q, v, action)
        for _ in range(mdp.repeat):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SolverWarning)  # a clip shows the result anyway
                q_next, v_next = mdp.move(robot.step, q_next, v_next, u)
            shown.append(mdp.robot(q_next)[0].numpy())
            returns.append(total)
        if not (torch.isfinite(q_next).all() and torch.isfinite(v_next).all()):
            keep = np.isfinite(np.stack(shown)).all(axis=1)
            return Episode(np.stack(shown)[keep], np.array(returns)[keep], mdp.dt / mdp.repeat, True)
        total += float(mdp.reward(q, v, action, q_next, v_next))
        returns[-1] = total
        q, v = q_next, v_next
        terminated = bool(mdp.terminated(q, v))
        if terminated:
            break
    return Episode(np.stack(shown), np.array(returns), mdp.dt / mdp.repeat, terminated)
