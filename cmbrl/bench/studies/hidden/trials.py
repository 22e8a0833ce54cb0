"""What trials of a policy in its model (``cmbrl.envs.trials``) foretell, and how often that was right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.bench.studies.hidden.judge import Result, of_model, watched
from cmbrl.bench.studies.hidden.plan import EPISODE_SEED
from cmbrl.envs.evaluation import Actor
from cmbrl.envs.trials import trials
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.train.policies.policy import observed_by

TRIALS = ("draws", "late", "pushed")
LAWS = ("law", "mujoco")  #: came later, one by one: results from before lack them
OF_FILES = ("parameters",)  #: of models without draws, which came later still


def tried(policy: Actor, mdp: MDP, model: ComplementarityModel, episodes: int) -> Result:
    """Episodes in the model by trial, with falls as in the hidden robot."""
    found = trials(policy, watched(observed_by(policy, mdp)), model, episodes, EPISODE_SEED, tell=True)
    return {name: of_model(evaluation) for name, evaluation in found.items()}


def scores(found: Result) -> dict[str, float]:
    """Numbers that should be high where a policy will fall: share of falls by trial, their mean, spread of returns."""
    falls = {name: float(np.mean(found[name]["falls"])) for name in TRIALS}
    laws = {f"falls: {name}": float(np.mean(found[name]["falls"])) for name in (*LAWS, *OF_FILES) if name in found}
    returns = np.array([x for x in found["draws"]["returns"] if x is not None] or [0.0])
    spread = float(returns.std() / max(abs(float(returns.mean())), 1e-9))
    together = {"falls: all": float(np.mean(list(falls.values()))), "spread": spread}
    return {f"falls: {name}": value for name, value in falls.items()} | laws | together


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
