"""Trials of a policy in its model alone, before the real robot: draws of the fit, late commands, pushes.

What falls there is said to fall in the real robot too; how often that is right is a result of the study.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.bench.studies.hidden.judge import Result, of_model, watched
from cmbrl.bench.studies.hidden.plan import EPISODE_SEED
from cmbrl.envs.evaluation import Actor, evaluate_model
from cmbrl.envs.simulation import Disturbance, parameter_sets
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import Model
from cmbrl.train.policy import observed_by

LATE = 1  #: control steps
PUSH, EVERY = 0.3, 1.0  #: m/s, either way along the track; s between pushes
TRIALS = ("draws", "late", "pushed")


def trials(policy: Actor, mdp: MDP, model: ComplementarityModel, episodes: int) -> Result:
    """Episodes in the model by trial; all under the model's draws, where it has any."""
    harder: dict[str, Model] = {
        "draws": model,
        "late": Disturbed(model, late=LATE),
        "pushed": Disturbed(model, push=PUSH, every=max(1, round(EVERY / mdp.dt))),
    }
    parameters = Disturbance(parameters=parameter_sets(model, 0.0, seed=EPISODE_SEED))
    process = watched(observed_by(policy, mdp))
    return {
        name: of_model(evaluate_model(policy, process, harder[name], episodes, EPISODE_SEED, parameters))
        for name in TRIALS
    }


class Disturbed:
    """``model`` whose control arrives ``late`` steps late (0 until then), and whose first velocity is pushed.

    For episodes that all begin with the first step; not for training.
    """

    def __init__(self, model: ComplementarityModel, late: int = 0, push: float = 0.0, every: int = 1) -> None:
        self.model, self.name, self.push, self.every = model, model.name, push, every
        self._late, self._steps, self._held = late, 0, deque[Tensor]()
        self._generator = torch.Generator().manual_seed(EPISODE_SEED)

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.model.dt

    def step(self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(q', v') under an earlier control."""
        if not self._steps:
            self._held.extend([torch.zeros_like(u)] * self._late)
        self._held.append(u)
        q_next, v_next = self.model.step(q, v, self._held.popleft(), theta)
        self._steps += 1
        if self.push and self._steps % self.every == 0:
            sign = 2.0 * torch.randint(2, (len(v),), generator=self._generator) - 1.0
            v_next = torch.cat([v_next[:, :1] + self.push * sign[:, None], v_next[:, 1:]], dim=1)
        return q_next, v_next


def scores(tried: Result) -> dict[str, float]:
    """Numbers that should be high where a policy will fall: share of falls by trial, their mean, spread of returns."""
    falls = {name: float(np.mean(tried[name]["falls"])) for name in TRIALS}
    returns = np.array([x for x in tried["draws"]["returns"] if x is not None] or [0.0])
    spread = float(returns.std() / max(abs(float(returns.mean())), 1e-9))
    return {f"falls: {name}": value for name, value in falls.items()} | {
        "falls: all": float(np.mean(list(falls.values()))),
        "spread": spread,
    }


def area(score: Sequence[float], label: Sequence[bool]) -> float | None:
    """Area under the curve of hits over false alarms: how often one that falls has the higher score; ties count half.

    None unless there are both kinds.
    """
    values, fell = np.asarray(score, dtype=float), np.asarray(label, dtype=bool)
    if fell.all() or not fell.any():
        return None
    difference = values[fell][:, None] - values[~fell][None]
    return float(np.mean((difference > 0) + 0.5 * (difference == 0)))


def hits(score: Sequence[float], label: Sequence[bool], threshold: float) -> dict[str, Any]:
    """Of ``label``: those ``found`` (score at least ``threshold``) and ``missed``, ``false`` alarms and ``quiet``."""
    said, fell = np.asarray(score, dtype=float) >= threshold, np.asarray(label, dtype=bool)
    return {
        "found": int((said & fell).sum()),
        "missed": int((~said & fell).sum()),
        "false": int((said & ~fell).sum()),
        "quiet": int((~said & ~fell).sum()),
    }
