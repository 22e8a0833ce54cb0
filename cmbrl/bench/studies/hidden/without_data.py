"""Policies that are trained without data, once, and tried on every hidden robot: the file as it is, or randomised."""

from __future__ import annotations

import numpy as np

from cmbrl.bench.studies.hidden.arms import NOMINAL, RANDOMISED, VARIED, setup, train_on
from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.hidden.plan import PARAMETERS, Plan
from cmbrl.bench.studies.mission.runs import Setup, Training
from cmbrl.models.complementarity import ComplementarityModel


def name_of(width: float) -> str:
    """Of the arm with this width of randomisation; 0: none."""
    return f"{RANDOMISED} {width:g}" if width else NOMINAL


def train(scene: str, width: float, seed: int, plan: Plan) -> Training:
    """No hidden robot is looked at: the draw only names the task."""

    def make(s: Setup) -> ComplementarityModel:
        return randomised(s.nominal, width, plan.draws_of_fit, seed) if width else s.nominal

    return train_on(setup(Hidden(scene, PARAMETERS, 0), seed, plan, None), plan, make)


def randomised(model: ComplementarityModel, width: float, count: int, seed: int) -> ComplementarityModel:
    """``model`` with candidates whose varied parameters are each off by a factor of 1 +- up to ``width``."""
    rng = np.random.default_rng(seed)
    varied = np.array([p.group in VARIED for p in model.scene.parameters])
    factors = np.where(varied, rng.uniform(1 - width, 1 + width, (count, len(varied))), 1.0)
    return model.with_settings(candidates=model.parameters * factors)
