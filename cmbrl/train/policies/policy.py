"""The policy: a small net from normalised observations to actions in [-1, 1]."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from cmbrl.envs.history import with_last_actions
from cmbrl.mdp import MDP
from cmbrl.train.policies.limits import Bounded
from cmbrl.train.policies.net import Net

ACTIVATIONS = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh, "silu": nn.SiLU}


class Normaliser(nn.Module):
    """Running mean and variance of observations (B, n_o), by the parallel update of Chan et al. (1979)."""

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("variance", torch.ones(width))
        self.register_buffer("count", torch.tensor(1e-4, dtype=torch.float64))

    def update(self, x: Tensor) -> None:
        """Includes the rows of x (B, n_o)."""
        variance, mean = torch.var_mean(x, dim=0, correction=0)
        total = self.count + len(x)
        share = (len(x) / total).to(x.dtype)
        delta = mean - self.mean
        self.variance.lerp_(variance, share).add_(delta.square() * share * (1 - share))
        self.mean.add_(delta * share)
        self.count.copy_(total)

    def forward(self, x: Tensor) -> Tensor:
        """x standardised and clipped at +-10 deviations."""
        return ((x - self.mean) * torch.rsqrt(self.variance + 1e-5)).clamp(-10.0, 10.0)


def network(
    inputs: int, hidden: Sequence[int], outputs: int, last_gain: float = 1.0, activation: str = "elu", norm: bool = True
) -> nn.Sequential:
    """Each hidden layer: linear, activation, LayerNorm if ``norm``; the last layer's initial weights times a gain.

    With ELU, which all training here has, it is a ``Net``.
    """
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(inputs, width), ACTIVATIONS[activation]()]
        layers += [nn.LayerNorm(width)] if norm else []
        inputs = width
    last = nn.Linear(inputs, outputs)
    with torch.no_grad():
        last.weight.mul_(last_gain)
        last.bias.zero_()
    kind = Net if activation == "elu" else nn.Sequential
    return kind(*layers, last)


@dataclass(frozen=True)
class Architecture:
    """What a policy's net looks like; the defaults are SHAC's."""

    observations: int
    actions: int
    hidden: tuple[int, ...] = (128, 64)
    activation: str = "elu"  #: one of ACTIVATIONS
    norm: bool = True  #: LayerNorm after each activation
    squash: str = "tanh"  #: how the net's output is mapped into [-1, 1]: "tanh" or "clip"
    normalise: bool = True  #: whether observations are standardised
    last_actions: int = 0  #: how many of its own last actions the observations end with, the newest first

    @classmethod
    def of(cls, mdp: MDP, hidden: tuple[int, ...], *more: Any, **named: Any) -> Architecture:
        """That of a policy in ``mdp``; the rest as in the class."""
        found = cls(mdp.observations, mdp.actions, hidden, *more, **named)
        return replace(found, last_actions=mdp.last_actions)


class Policy(nn.Module):
    """a = squash(net(normalised o) + noise), float32; the deterministic action has no noise."""

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        a = self.architecture = architecture
        self.normaliser = Normaliser(a.observations)
        self.net = network(a.observations, a.hidden, a.actions, 0.1, a.activation, a.norm)

    def forward(self, observation: Tensor) -> Tensor:
        """Deterministic actions (B, n_a) in [-1, 1] of observations (B, n_o), float32."""
        return self.squash(self.drive(observation))

    def sample(self, observation: Tensor, noise: Tensor, least: float = 0.0) -> Tensor:
        """Actions with ``noise`` (B, n_a) added before the squashing: differentiable (reparameterised).

        ``least``: of the slope of tanh to gradients that lead back from a limit (:mod:`cmbrl.train.policies.limits`).
        """
        noisy = self.drive(observation) + noise
        return Bounded.apply(noisy, least) if least and self.architecture.squash == "tanh" else self.squash(noisy)

    def drive(self, observation: Tensor) -> Tensor:
        """The net's output before squashing, without noise (B, n_a)."""
        return self.net(self.normaliser(observation) if self.architecture.normalise else observation)

    def held(self) -> AbstractContextManager[None]:
        """Inside, the weights do not change, which makes many calls faster."""
        return self.net.held() if isinstance(self.net, Net) else nullcontext()

    def squash(self, drive: Tensor) -> Tensor:
        """Actions (B, n_a) of a drive, in [-1, 1]."""
        return torch.tanh(drive) if self.architecture.squash == "tanh" else drive.clamp(-1.0, 1.0)


def observed_by(actor: object, mdp: MDP) -> MDP:
    """A task's ``mdp`` as an actor observes it: a policy may see its last actions."""
    return with_last_actions(mdp, actor.architecture.last_actions) if isinstance(actor, Policy) else mdp
