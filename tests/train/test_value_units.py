"""The critic's units: values stay as they change, and learning does not depend on the size of a reward."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

import cmbrl
from cmbrl.train.policies.policy import network
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.windows.value_units import SHARE, ValueUnits

from . import slider

CONFIG = SHACConfig(
    iterations=40, environments=16, horizon=4, actor_hidden=(16,), critic_hidden=(16,), clip=float("inf"), discount=0.99
)


def test_values_stay_when_the_units_follow_the_targets() -> None:
    units, net, x = ValueUnits(), network(3, (8,), 1), torch.randn(20, 3)
    assert not units.value(net(x)[:, 0]).any(), "nothing is known yet"
    units.follow(torch.tensor([90.0, 110.0]), net)
    assert not units.value(net(x)[:, 0]).any()
    assert (float(units.mean), float(units.deviation)) == (100.0, pytest.approx(10.0))
    with torch.no_grad():
        net[-1].weight.normal_()
    before = units.value(net(x)[:, 0])
    units.follow(torch.tensor([-4e3, 1e3]), net)
    mean = (1 - SHARE) * 100.0 + SHARE * -1500.0
    square = (1 - SHARE) * 10_100.0 + SHARE * 8.5e6
    assert float(units.mean) == pytest.approx(mean)
    assert float(units.deviation) == pytest.approx((square - mean**2) ** 0.5, rel=1e-5)
    torch.testing.assert_close(units.value(net(x)[:, 0]), before, rtol=1e-4, atol=1e-2)
    torch.testing.assert_close(units.value(units.goal(before)), before)


@pytest.mark.parametrize("target", [0.0, 7.0])
def test_equal_targets_have_a_value(target: float) -> None:
    """As of a reward that no state has earned yet: no division by 0, and what differs next is learned."""
    units, net, x = ValueUnits(), network(3, (8,), 1), torch.randn(20, 3)
    units.follow(torch.full((5,), target), net)
    units.follow(torch.empty(0), net)
    assert torch.isfinite(units.goal(torch.full((5,), target))).all()
    units.follow(torch.tensor([target, target + 1.0]), net)
    assert torch.isfinite(units.value(net(x)[:, 0])).all()
    assert float(units.deviation) > 0.1


@pytest.mark.parametrize("size", [1e-4, 1e4])
def test_a_critic_learns_rewards_of_any_size_alike(size: float, tmp_path: Path) -> None:
    """What it says of a reward of another size is another size too: a tenth of a value where it was divided by 10."""
    values = []
    for factor in (1.0, size):
        plain = slider.mdp()
        mdp = replace(plain, reward=lambda *step, plain=plain, factor=factor: factor * plain.reward(*step))
        trainer = SHAC(mdp, cmbrl.ComplementarityModel(slider.scene(tmp_path), time_step=slider.DT), CONFIG, seed=0)
        for _ in range(20):
            trainer.critic.fit(trainer.roll(0.0))
        observations = torch.linspace(-0.8, 0.8, 9)[:, None] * torch.tensor([1.0, 0.5])
        values.append(trainer.critic.value(observations) / factor)
    assert float(values[0].detach().std()) > 0.1, "it has learned what tells states apart"
    torch.testing.assert_close(*values, rtol=0.02, atol=0.02)
