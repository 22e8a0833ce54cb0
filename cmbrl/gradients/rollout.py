"""The return of a policy over a horizon as a function of its parameters, one initial state per sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.models.protocol import Model, forget

ParametricPolicy = Callable[[Tensor, Tensor, Tensor], Tensor]  #: parameters (B, n), q (B, nq), v (B, nv) -> u (B, nu)
Launch = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]  #: parameters, q, v -> q, v at the start
Reward = Callable[[Tensor, Tensor, Tensor], Tensor]  #: u (B, nu), q' (B, nq), v' (B, nv) -> (B,)
Act = Callable[[Tensor], Tensor]  #: the policy's control (B, nu) -> the applied one
Arrive = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  #: the model's next state -> the one to continue from


@dataclass(frozen=True)
class TanhPolicy:
    """u = limit tanh(W y + b) with y = features(q, v) (B, f); parameters (B, nu (f + 1)): rows of (W, b)."""

    features: Callable[[Tensor, Tensor], Tensor]
    count: int  #: f
    controls: int  #: nu
    limit: float = 1.0

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.controls * (self.count + 1)

    def __call__(self, x: Tensor, q: Tensor, v: Tensor) -> Tensor:
        """Controls (B, nu); every sample has its own parameters x (B, size)."""
        weights = x.view(len(x), self.controls, self.count + 1)
        drive = torch.einsum("buf,bf->bu", weights[:, :, :-1], self.features(q, v)) + weights[:, :, -1]
        return self.limit * torch.tanh(drive)


@dataclass(frozen=True)
class Rollout:
    """Sum of rewards over ``horizon`` control steps from the states q (B, nq), v (B, nv): an ``Objective``.

    Args:
        model: any differentiable next-state model; its smoothing determines the derivative.
        policy: maps parameters and state to controls.
        reward: of the control and the state that it leads to.
        horizon: control steps, at least 1.
        q, v: initial states, float64; sample i always starts at row i.
        scale: model steps per step (1 + its size for a bundle).
        launch: applies the parameters to the initial state (a throw); default: nothing.
    """

    model: Model
    policy: ParametricPolicy
    reward: Reward
    horizon: int
    q: Tensor
    v: Tensor
    scale: int = 1
    launch: Launch | None = None

    @property
    def steps(self) -> int:
        """Model steps of one sample."""
        return self.horizon * self.scale

    def __call__(self, x: Tensor) -> Tensor:
        """Returns (B,) of policies with parameters x (B, n); raises UserError unless there is one row per start."""
        return torch.stack(self.rewards(x)).sum(dim=0)

    def rewards(self, x: Tensor, act: Act | None = None, arrive: Arrive | None = None) -> list[Tensor]:
        """Rewards (B,) of each step, with noise added by ``act`` (on controls) and ``arrive`` (on states)."""
        if len(x) != len(self.q):
            raise UserError(f"{len(x)} policies for {len(self.q)} initial states: give one row for each")
        q, v = self.launch(x, self.q, self.v) if self.launch else (self.q, self.v)
        forget(self.model)
        rewards = []
        for _ in range(self.horizon):
            u = self.policy(x, q, v)
            u = act(u) if act else u
            q, v = self.model.step(q, v, u)
            q, v = arrive(q, v) if arrive else (q, v)
            rewards.append(self.reward(u, q, v))
        return rewards
