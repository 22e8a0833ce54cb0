"""A trust region: how far an update may move a policy, whatever its learning rate.

Adam's steps are about as long for a gradient that is noise as for one that is not, and a policy that has learned much
stands on a ridge: a step too far, and episodes fail that did not before. The distance that counts is that of the
actions. It is measured as in TRPO (Schulman et al. 2015) by the Kullback-Leibler divergence, here of the new policy's
Gaussian from the old one's over the window's observations, and too long a step is shortened, not searched again.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from cmbrl.train.policies.policy import Policy
from cmbrl.train.windows.optimiser import PolicyOptimiser


@torch.no_grad()
def bounded_step(optimiser: PolicyOptimiser, policy: Policy, observations: Tensor, std: float, most: float) -> float:
    """One step of the optimiser, shortened where it would move the policy by more than ``most``.

    The divergence is that before tanh, which does not change it. It grows with the square of the step's length.

    Args:
        optimiser: of the policy's net, whose parameters hold their gradients.
        policy: is changed.
        observations: (N, n_o), over which the divergence is averaged.
        std: standard deviation of the noise that is added before tanh.
        most: mean divergence from the old policy to the new one, summed over actions.

    Returns the divergence of the whole step.
    """
    rows = observations.float()
    net, before = policy.net, policy.drive(rows)
    old = [parameter.clone() for parameter in net.parameters()]
    optimiser.step()
    moved = float((policy.drive(rows) - before).square().sum(dim=1).mean() / (2.0 * std**2))
    if moved > most:
        share = math.sqrt(most / moved)
        for parameter, was in zip(net.parameters(), old, strict=True):
            parameter.copy_(was.lerp(parameter, share))
    return moved
