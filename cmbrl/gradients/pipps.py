"""Total propagation (PIPPS): path gradient and score function, mixed by inverse variance at every noisy node.

Parmas, Rasmussen, Peters & Doya, "PIPPS: Flexible Model-Based Policy Search Robust to the Curse of Chaos" (ICML 2018),
algorithm 1. Their model is noisy everywhere; here noise is added to a deterministic simulator.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.gradients.estimate import Array, Estimate
from cmbrl.gradients.rollout import Rollout
from cmbrl.gradients.score import leave_one_out


class Future:
    """Return (N,) of every particle from some node onwards, known only after the rollout."""

    def __init__(self) -> None:
        self.value: Tensor | None = None


class NoisyNode(torch.autograd.Function):
    """mean (N, n) + std * unit noise; backwards, the mean gets total propagation's message.

    Differentiate the SUM of the particles' returns (neither their mean nor a loss).
    """

    @staticmethod
    def forward(ctx: Any, mean: Tensor, noise: Tensor, std: float, future: Future) -> Tensor:  # type: ignore[override]
        """noise (N, n) of unit deviation."""
        ctx.noise, ctx.std, ctx.future = noise, std, future
        return mean + std * noise

    @staticmethod
    def backward(ctx: Any, path: Tensor) -> Any:  # type: ignore[override]
        """``path`` is the reparameterised message; raises UserError if the future was not filled in."""
        value = ctx.future.value
        if value is None:
            raise UserError("a noisy node does not know its return: set Future.value before backward()")
        score = (value - leave_one_out(value))[:, None] * ctx.noise / ctx.std
        return combine(path, score.to(path.dtype)), None, None, None


def combine(path: Tensor, score: Tensor) -> Tensor:
    """Both messages (N, n), weighted by the inverse of their variances over particles; equally if both vanish.

    Particles whose message is not finite are excluded from its variance. A variance that overflows counts as infinite.
    """
    variances = [_spread(message) for message in (path, score)]
    k = path_weight(*variances)
    if k == 0.0:  # avoids 0 * NaN
        return score
    return score + k * (path - score)


def path_weight(v_path: float, v_score: float) -> float:
    """k_RP = V_LR / (V_RP + V_LR); 1/2 where both vanish."""
    if v_path == v_score:
        return 0.5
    if not np.isfinite(v_path):
        return 0.0
    if not np.isfinite(v_score):
        return 1.0
    return v_score / (v_path + v_score)


def _spread(message: Tensor) -> float:
    usable = message[torch.isfinite(message).all(dim=1)].double()
    if not len(usable):
        return float("inf")
    return float((usable - usable.mean(dim=0)).square().sum() / len(usable))


def returns_to_go(rewards: list[Tensor]) -> list[Tensor]:
    """Sum of the rewards (N,) from each step onwards."""
    return list(torch.stack(rewards).flip(0).cumsum(0).flip(0))


def total_propagation(
    rollout: Rollout, x: Array, std: float, rng: np.random.Generator, state_std: tuple[float, float] = (0.0, 0.0)
) -> Estimate:
    """Gradient in x (n,) of the expected return with noise ``std`` on controls and ``state_std`` on (q, v), each step.

    One particle starts from each of the rollout's initial states. Particles share baselines and weights, so that their
    gradients are slightly dependent and the mean has a bias of order 1/N.
    Raises UserError without noise on controls, and for noise on quaternions.
    """
    if not std > 0 or min(state_std) < 0:
        raise UserError(f"total propagation with noise {std} on controls, {state_std} on states: give a positive std")
    if state_std[0] > 0 and rollout.q.shape[1] != rollout.v.shape[1]:
        raise UserError("quaternions cannot have additive noise: give noise on velocities only, state_std = (0, ...)")
    at_controls: list[Future] = []
    at_states: list[Future] = []

    def node(mean: Tensor, deviation: float, future: Future) -> Tensor:
        if not deviation:
            return mean
        return NoisyNode.apply(mean, torch.from_numpy(rng.normal(size=mean.shape)), deviation, future)

    def act(mean: Tensor) -> Tensor:
        at_controls.append(Future())
        return node(mean, std, at_controls[-1])

    def arrive(q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        at_states.append(Future())
        state = [node(z, s, at_states[-1]) for z, s in zip((q, v), state_std, strict=True)]
        return state[0], state[1]

    samples = len(rollout.q)
    parameters = torch.tensor(np.tile(x, (samples, 1)), requires_grad=True)
    rewards = rollout.rewards(parameters, act, arrive)
    # The state after step t decides r_t, the reward of the state that a control leads to, and all later rewards.
    for control, state, value in zip(at_controls, at_states, returns_to_go([r.detach() for r in rewards]), strict=True):
        control.value = state.value = value
    (gradients,) = torch.autograd.grad(torch.stack(rewards).sum(), parameters)
    return Estimate(gradients.numpy(), samples * rollout.steps, samples * rollout.steps)
