"""Every estimator's gradient at one and the same policy: how noisy it is, and how much of what it promises is true.

Half of the windows give a direction; the other half say how steep the estimator takes the return to be along it, and
differences of the hard return on noise of its own say how steep it is. So no gradient in thousands of parameters has to
be known, and neither half flatters the other. The differences are over a step such as learning takes: where the return
is rough, a derivative may be right at its point and tell nothing of that step.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.estimators.arms import ABS, ARMS
from cmbrl.bench.studies.estimators.cells import Work, nominal
from cmbrl.bench.studies.estimators.learning import Learning
from cmbrl.gradients.estimate import Estimate
from cmbrl.train.fopg import FOPG

STEP = 0.02  #: length of a difference in the space of all weights, less than one of Adam's updates
WARM = 5  #: windows from the reset to the states at which gradients are taken
NOISE_SEED = 17


def probe(folder: Path, task: str, seed: int, work: Work) -> dict[str, Any]:
    """Name -> :func:`judge`, kept in ``folder``; the policy is that of ABS after ``work.probe_updates`` updates."""
    names = [n for n in work.contenders if ARMS[n].estimator not in ("shac", "ars")]
    learning, samples = work.learning[task], work.probe_samples
    key = {"task": task, "seed": seed, "names": names, "updates": work.probe_updates, "samples": samples,
           "windows": [learning.samples, learning.horizon, learning.discount, learning.episode_steps],
           "contenders": [str(ARMS[n]) for n in names]}  # fmt: skip

    def compute() -> dict[str, Any]:
        mdp, hard = nominal(task)
        teacher = ARMS[ABS].trainer(mdp, hard, learning, seed)
        assert isinstance(teacher, FOPG)
        for _ in range(work.probe_updates):
            teacher.update()
        wide = Learning(samples, learning.horizon, learning.discount, learning.episode_steps)
        judged = FOPG(mdp, hard, wide.fopg("pathwise"), seed + 1)
        _copy(teacher, judged)
        with torch.no_grad():
            for _ in range(WARM):
                judged.roll(judged.simulation)
        return {name: judge(name, judged, seed) for name in names}

    return kept(folder / f"probe_{task}_{seed}.json", key, compute)


def judge(name: str, judged: FOPG, seed: int) -> dict[str, float | None]:
    """One estimator at the policy and the states of ``judged``.

    ``noise``: standard error of the mean of one window of each sample, relative to its norm; ``variance``: of one
    window; ``claimed`` and ``true``: slopes of a window's return along the estimate, ``claimed_error`` and
    ``true_error`` their standard errors; ``failed``: share of windows that are not finite.
    """
    learning = Learning(judged.config.samples, judged.horizon, judged.config.discount)
    trainer = ARMS[name].trainer(judged.mdp, judged.model, learning, seed)  # type: ignore[arg-type]
    assert isinstance(trainer, FOPG)
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
    return {
        "noise": _number(estimate.standard_error / np.linalg.norm(estimate.mean)),
        "variance": _number(estimate.total_variance),
        "claimed": _number(claims.mean()),
        "claimed_error": _number(claims.std() / np.sqrt(len(claims))),
        "true": _number(true),
        "true_error": _number(error),
        "failed": estimate.failed / len(estimate.gradients),
    }


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
    """Policy, critic and the size of the noise; the normaliser, too, is a copy that no longer moves with its source."""
    target.policy.load_state_dict(source.policy.state_dict())
    assert target.critic is not None
    assert source.critic is not None
    target.critic.target.load_state_dict(source.critic.target.state_dict())
    target.std = source.std


def _number(x: Any) -> float | None:
    return float(x) if np.isfinite(x) else None
