"""The gradient job: every estimator at one and the same policy; how noisy it is, and how much of its promise is true.

Half of the windows give a direction. The other half give the slope of the return along it as the estimator claims it,
and differences of the hard return, on separate noise, give the true slope. So no gradient in thousands of parameters
has to be known, and neither half flatters the other. The differences are over a step as in learning: where the return
is rough, a derivative may be right at its point and say nothing about that step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from cmbrl.bench.studies.estimators.arms import ARMS, EXACT, GAUSSIAN
from cmbrl.bench.studies.estimators.learning import Learning
from cmbrl.gradients.estimate import Estimate
from cmbrl.train.fopg import FOPG

STEP = 0.02  #: length of a difference in the space of all weights, shorter than an update by Adam
WARM = 5  #: windows from the reset to the states at which gradients are taken
NOISE_SEED = 17


def probe(task: str, arms: Sequence[str], seed: int, learning: Learning, updates: int, samples: int) -> dict[str, Any]:
    """Name -> :func:`judge` at the policy of the Gaussian schedule after ``updates``, from ``samples`` windows each."""
    teacher = ARMS[GAUSSIAN].trainer(task, learning, seed)
    for _ in range(updates):
        teacher.update()
    wide = replace(learning, samples=samples)
    judged = ARMS[EXACT].trainer(task, wide, seed + 1)
    _copy(teacher, judged)
    with torch.no_grad():
        for _ in range(WARM):
            judged.roll(judged.simulation)
    return {name: judge(judged, ARMS[name].trainer(task, wide, seed)) for name in arms}


def judge(judged: FOPG, trainer: FOPG) -> dict[str, float | None]:
    """The estimator of ``trainer`` at the policy and the states of ``judged``.

    ``noise``: standard error of the mean over the windows of one sample each, relative to its norm; ``variance``: of
    one window; ``claimed`` and ``true``: slopes of a window's return along the estimate, ``claimed_error`` and
    ``true_error`` their standard errors; ``failed``: share of windows that are not finite.
    """
    _copy(judged, trainer)
    for simulation in trainer.simulations:
        simulation.restore(judged.simulation.state() | {"model": None})
    trainer.generator.manual_seed(NOISE_SEED)
    estimate = trainer.estimate()
    halves = [Estimate(estimate.gradients[k::2], 0) for k in (0, 1)]
    direction = halves[0].mean / np.linalg.norm(halves[0].mean)
    true, error = slope(judged, direction)
    claims = halves[1].gradients @ direction
    claims = claims[np.isfinite(claims)]
    found = {
        "noise": estimate.standard_error / np.linalg.norm(estimate.mean),
        "variance": estimate.total_variance,
        "claimed": claims.mean(),
        "claimed_error": claims.std() / np.sqrt(len(claims)),
        "true": true,
        "true_error": error,
        "failed": estimate.failed / len(estimate.gradients),
    }
    return {key: float(x) if np.isfinite(x) else None for key, x in found.items()}


def slope(judged: FOPG, direction: np.ndarray) -> tuple[float, float]:
    """Slope of a window's hard return, with the critic's value of its end, along a unit vector; and its error."""
    state, parameters = judged.simulation.state(), list(judged.policy.net.parameters())
    here = parameters_to_vector(parameters).detach()
    values = []
    for sign in (1.0, -1.0):
        vector_to_parameters(here + sign * STEP * torch.from_numpy(direction).float(), parameters)
        judged.simulation.restore(state)
        judged.generator.manual_seed(NOISE_SEED + 1)
        with torch.no_grad():
            window = judged.roll(judged.simulation)
        values.append(torch.stack(window.rewards).sum(dim=0))
    vector_to_parameters(here, parameters)
    judged.simulation.restore(state)
    difference = ((values[0] - values[1]) / (2 * STEP)).numpy()
    return float(difference.mean()), float(difference.std(ddof=1) / np.sqrt(len(difference)))


def _copy(source: FOPG, target: FOPG) -> None:
    """Copies policy with normaliser, critic and the size of the noise."""
    target.policy.load_state_dict(source.policy.state_dict())
    assert target.critic is not None
    assert source.critic is not None
    target.critic.target.load_state_dict(source.critic.target.state_dict())
    target.critic.units.restore(source.critic.units.state())
    target.std = source.std
