"""What a policy is worth in a hidden robot, in truth and not as measured, and how often it falls."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.bench.studies.hidden.hidden_system import Hidden, HiddenSystem
from cmbrl.bench.studies.hidden.plan import EPISODE_SEED, UPSIDE_DOWN
from cmbrl.envs.evaluation import Actor, Evaluation, evaluate_real
from cmbrl.mdp import MDP
from cmbrl.train.policies.policy import observed_by

PITCH = 2  #: place of the torso's pitch in q, of both robots
Result = dict[str, Any]


def real(policy: Actor, mdp: MDP, hidden: Hidden, episodes: int) -> Result:
    """Episodes in the hidden robot. The policy sees measured states; returns and falls are those of the true ones.

    ``last``: the coordinates in which each episode ended, since they tell how a robot fell. Both robots' actions are
    their controls.
    """
    made: list[HiddenSystem] = []
    make = hidden.systems()

    def robot() -> HiddenSystem:
        made.append(make())
        return made[-1]

    seen = evaluate_real(policy, observed_by(policy, mdp), robot, episodes, EPISODE_SEED, keep=True)
    episodes_told = [_episode(mdp, robot, u) for robot, u in zip(made, seen.u, strict=True)]
    last = [robot.path[length][0].tolist() for robot, (_, length, _) in zip(made, episodes_told, strict=True)]
    return told(episodes_told) | {"last": last}


def _episode(mdp: MDP, robot: HiddenSystem, u: np.ndarray) -> tuple[float, int, bool]:
    """True return, length and fall of the episode that a robot has just gone through under controls u (T, nu)."""
    q, v = (torch.from_numpy(np.stack(part)) for part in zip(*robot.path[: len(u) + 1], strict=True))
    action = torch.from_numpy(u)
    finite = torch.isfinite(q).all(dim=1) & torch.isfinite(v).all(dim=1)
    over = mdp.terminated(q[1:], v[1:]) | ~finite[1:]
    end = int(over.nonzero()[0, 0]) + 1 if over.any() else len(u)
    reward = mdp.reward(q[:-1], v[:-1], action, q[1:], v[1:])[:end]
    rolled = float(upside_down(q[1 : end + 1]).mean())
    return float(reward.nan_to_num().sum()), end, bool(over.any()) or rolled > UPSIDE_DOWN


def told(episodes: list[tuple[float, int, bool]]) -> Result:
    """Plain data of episodes."""
    returns, lengths, falls = zip(*episodes, strict=True)
    return {
        "returns": [x if math.isfinite(x) else None for x in returns],
        "lengths": list(lengths),
        "falls": list(falls),
    }


def of_model(found: Evaluation) -> Result:
    """The same of episodes in a model, in the process of :func:`watched`."""
    falls = found.terminated | (found.info["upside_down"] > UPSIDE_DOWN)
    rows = zip(found.returns.tolist(), found.lengths.tolist(), falls.tolist(), strict=True)
    return told(list(rows))


def upside_down(q: Tensor) -> Tensor:
    """(B,) 1 where the torso is beyond 90 degrees."""
    return (torch.cos(q[:, PITCH]) < 0).double()


def watched(mdp: MDP) -> MDP:
    """``mdp`` that also tells of every step whether the torso is upside down; its reward is the same."""

    def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
        return {"upside_down": upside_down(q_next)}

    return replace(mdp, info=info)
