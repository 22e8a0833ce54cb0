"""Gradients at the limits of actions: what leads back from there counts, so that a policy can unlearn to be there."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import cmbrl
from cmbrl.gradients.per_sample import per_sample_gradients
from cmbrl.mdp import never, uniform
from cmbrl.train.policies.limits import SLOPE, Bounded, Pinned, at_limits, slope
from cmbrl.train.recipe import window
from cmbrl.train.shac import SHAC, SHACConfig, at_drive

from . import slider

PENDULUM = """<mujoco><option timestep=".02"/><worldbody><body><joint name="hinge" axis="0 1 0" damping=".1"/>
<geom size=".05" pos="0 0 .5" mass="1"/></body></worldbody>
<actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_tanh_keeps_its_slope_but_where_it_is_flat_to_what_leads_back() -> None:
    """Gradients of a loss: a step goes against them. Actions, and all with a least slope of 0, are those of tanh."""
    drive = torch.tensor([[-3.0, -3.0, 0.0, 0.3, 3.0, 3.0, 1.5, 1.5]], requires_grad=True)
    gradient = torch.tensor([[1.0, -1.0, 2.0, 1.0, 1.0, -1.0, 1.0, -1.0]])  # of -3: on to the limit, and back
    flat = 1 - torch.tanh(drive.detach()).square()
    for least in (0.0, 0.2):
        action = Bounded.apply(drive, least)
        torch.testing.assert_close(action, torch.tanh(drive))
        (found,) = torch.autograd.grad(action, drive, gradient)
        expected = flat.clone()
        if least:
            expected[0, [1, 4, 6, 7]] = least  # an action of .905 is not at its limit
        torch.testing.assert_close(found, gradient * expected)
        torch.testing.assert_close(slope(action.detach(), gradient, least), expected)


@pytest.mark.parametrize("least", [0.0, 0.2])
def test_gradients_of_pinned_policies_are_those_of_their_actions(least: float, tmp_path: Path) -> None:
    """The update's gradient, and that of single episodes, have the least slope."""
    model = cmbrl.ComplementarityModel(slider.scene(tmp_path), time_step=slider.DT)
    config = SHACConfig(environments=8, horizon=4, actor_hidden=(8,), critic_hidden=(8,), least_slope=least)
    trainer = SHAC(slider.mdp(), model, config, seed=0)
    with torch.no_grad():
        trainer.policy.net[-1].bias.fill_(4.0)
    steps = trainer.roll(0.0)
    trainer.loss(steps).backward()
    actions = torch.cat([step.action for step in steps]).detach()
    assert actions.min() > 0.99
    assert at_limits([step.action for step in steps]) == 1.0
    gradients = torch.cat([step.action.grad for step in steps])
    back = gradients > 0
    assert back.any()
    assert not back.all()
    slopes = torch.where(back, torch.full_like(actions, least).maximum(1 - actions**2), 1 - actions**2)
    assert float(trainer.policy.net[-1].bias.grad) == pytest.approx(float((gradients * slopes).sum()), rel=1e-4)
    observations = torch.stack([step.observation.detach().float() for step in steps], dim=1)
    messages = torch.stack([at_drive(step.action, least) for step in steps], dim=1)
    rows = per_sample_gradients(trainer.policy.net, trainer.policy.normaliser(observations), messages)
    whole = torch.cat([p.grad.flatten() for p in trainer.policy.net.parameters()])
    torch.testing.assert_close(rows.sum(dim=0), whole, rtol=1e-3, atol=1e-5 * float(whole.abs().max()))


def test_the_least_slope_acts_while_a_policy_is_pinned(tmp_path: Path) -> None:
    """By default; not from a few updates alone, and a run that is resumed knows."""
    model = cmbrl.ComplementarityModel(slider.scene(tmp_path), time_step=slider.DT)
    config = SHACConfig(environments=4, horizon=2, actor_hidden=(8,), critic_hidden=(8,))
    trainer, other = (SHAC(slider.mdp(), model, config, seed=0) for _ in range(2))
    assert trainer.least_slope == 0.0
    with torch.no_grad():
        trainer.policy.net[-1].bias.fill_(6.0)
    slopes = []
    for _ in range(40):
        trainer.update()
        slopes.append(trainer.least_slope)
    assert slopes[:5] == [0.0] * 5
    assert slopes[-1] == SLOPE
    other.restore(trainer.state())
    assert other.least_slope == SLOPE
    assert SHAC(slider.mdp(), model, replace(config, least_slope=0.0), seed=0).least_slope == 0.0
    pinned = Pinned(1.0)
    for _ in range(40):
        pinned.take(0.1)
    assert pinned.slope == 0.0


@pytest.mark.slow
def test_a_pendulum_with_a_weak_motor_swings_up_and_stays(tmp_path: Path) -> None:
    """Its motor holds a fifth of its weight. Pinned at full torque it spins, and earns .54 a step at best."""
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM, encoding="utf-8")
    mdp = replace(
        slider.mdp(1000),
        observations=3,
        observe=lambda q, v: torch.cat([q.cos(), q.sin(), v], dim=1),
        reward=lambda q, v, action, q_next, v_next: (1 + q_next[:, 0].cos()) / 2,
        reset=lambda count, g: (uniform(count, 1, math.pi, g), torch.zeros(count, 1, dtype=torch.float64)),
        terminated=never,
        dt=0.02,
    )
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(path), time_step=0.02)
    config = SHACConfig(
        iterations=300, environments=128, noise_linear=0.05, noise_angular=0.16, critic_hidden=(64, 64),
        **window(mdp),
    )  # fmt: skip
    trainer = SHAC(mdp, model, config, seed=0)
    for _ in range(config.iterations):
        trainer.update()
    assert trainer._earned() > 750
