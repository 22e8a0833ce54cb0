"""Zeroth order with noise on the controls: the score function (REINFORCE) with a baseline; no derivatives.

Williams, "Simple statistical gradient-following algorithms" (Machine Learning 1992); the baselines: Suh et al., "Do
Differentiable Simulators Give Better Policy Gradients?" (ICML 2022), definition 2.5, and the mean of the other samples.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.gradients.estimate import Array, Estimate
from cmbrl.gradients.rollout import Rollout

BASELINES = ("nominal", "others", "none")


def score_function(
    rollout: Rollout, x: Array, std: float, rng: np.random.Generator, baseline: str = "nominal"
) -> Estimate:
    """Gradient in x (n,) of E V(w), controls u_t = pi + w_t, w normal: mean of [V(w) - b] sum_t (dpi/dx)^T w_t / std^2.

    Args:
        rollout: its return is V; one sample per initial state.
        std: of the noise, in units of the control.
        baseline: b. "nominal": V(0) of the same initial state (costs a second rollout); "others": the mean return of
            the other samples (free); "none".

    Raises UserError for an unknown baseline, no noise, or parameters that act on the launch, which has no noise.
    """
    samples = len(rollout.q)
    if baseline not in BASELINES or not std > 0 or rollout.launch is not None:
        raise UserError(
            f"score function with baseline {baseline!r}, noise {std}: needs one of {', '.join(BASELINES)}, some noise, "
            "and a policy that acts by controls alone"
        )
    parameters = torch.tensor(np.tile(x, (samples, 1)), requires_grad=True)
    score = torch.zeros(samples, dtype=torch.float64)

    def act(mean: Tensor) -> Tensor:
        nonlocal score
        noise = torch.from_numpy(std * rng.normal(size=mean.shape))
        score = score + (mean * noise).sum(dim=1) / std**2
        return mean.detach() + noise  # states carry no graph, so that the model is not differentiated

    value = torch.stack(rollout.rewards(parameters, act)).sum(dim=0).detach()
    cost = rollout.steps
    if baseline == "nominal":
        with torch.no_grad():
            value = value - rollout(parameters)
        cost = 2 * rollout.steps
    elif baseline == "others":
        value = value - leave_one_out(value)
    (gradients,) = torch.autograd.grad((value * score).sum(), parameters)
    return Estimate(gradients.numpy(), samples * cost)


def leave_one_out(values: Tensor) -> Tensor:
    """For each of the values (N, ...) the mean of the others along the first axis; 0 for a single one."""
    return (values.sum(dim=0) - values) / max(len(values) - 1, 1)
