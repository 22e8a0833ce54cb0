"""Steps of a policy that stay within a trust region."""

from __future__ import annotations

import copy
from dataclasses import replace

import pytest
import torch
from torch.distributions import Independent, Normal, kl_divergence

from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.windows.optimiser import PolicyOptimiser
from cmbrl.train.windows.trust import bounded_step

STD = 0.2


def prepared(rate: float = 1e-2) -> tuple[Policy, PolicyOptimiser, torch.Tensor]:
    """A policy whose parameters hold a gradient, its optimiser, and observations (200, 5)."""
    torch.manual_seed(3)
    policy = Policy(Architecture(5, 3, (16,)))
    optimiser = PolicyOptimiser(policy.net, "adam", rate, (0.9, 0.99))
    observations = torch.randn(200, 5)
    policy(observations).square().sum().backward()
    return policy, optimiser, observations


def divergence(old: Policy, new: Policy, observations: torch.Tensor) -> float:
    """By torch's closed form for Gaussians."""
    with torch.no_grad():
        before, after = (Independent(Normal(p.drive(observations), STD), 1) for p in (old, new))
        return float(kl_divergence(before, after).mean())


def test_a_step_inside_the_region_is_the_optimiser_s_and_its_divergence_is_that_of_gaussians():
    policy, optimiser, observations = prepared()
    old, (plain, plainly, _) = copy.deepcopy(policy), prepared()
    plainly.step()
    told = bounded_step(optimiser, policy, observations, STD, 1e9)
    for found, expected in zip(policy.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(found, expected, rtol=0.0, atol=0.0)
    assert told == pytest.approx(divergence(old, policy, observations), rel=1e-4)


def test_a_step_out_of_the_region_goes_the_same_way_to_its_edge():
    policy, optimiser, observations = prepared()
    old, (plain, plainly, _) = copy.deepcopy(policy), prepared()
    plainly.step()
    whole = divergence(old, plain, observations)
    told = bounded_step(optimiser, policy, observations, STD, whole / 9)
    assert told == pytest.approx(whole, rel=1e-4)
    assert divergence(old, policy, observations) == pytest.approx(whole / 9, rel=0.1)
    for was, found, expected in zip(old.parameters(), policy.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(found - was, (expected - was) / 3, rtol=1e-3, atol=1e-6)


def test_shac_tells_how_far_its_steps_would_go_and_goes_less_far():
    from .test_shac import SMALL, make

    free, bound = make(), make(replace(SMALL, trust=1e-4))
    start = copy.deepcopy(free.policy.net.state_dict())
    assert "divergence" not in free.update()
    assert bound.update()["divergence"] > 1e-4

    def moved(policy: Policy) -> float:
        return sum(float((p - start[name]).square().sum()) for name, p in policy.net.state_dict().items())

    assert 0.0 < moved(bound.policy) < 0.25 * moved(free.policy)
