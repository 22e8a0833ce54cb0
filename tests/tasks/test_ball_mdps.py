"""The throws as decision processes: what an action does, that contact is needed, and that the goals can be reached."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cmbrl.contact import Exact
from cmbrl.envs.evaluation import evaluate_model, evaluate_real
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.tasks.ball_throw import mdp as throws

pytest.importorskip("pymunk")
from cmbrl.tasks.ball_throw import real

# Where a scan of the real system over the launch velocities found the goal [m/s].
SOLUTIONS = {
    "ball_throw": (throws.BANK, (5.6, -3.2)),
    "ball_over": (throws.OVER, (4.14, -4.03)),
    "ball_slide": (throws.SLIDE, (2.26, -2.0)),
}
EACH = pytest.mark.parametrize("name", SOLUTIONS)


def true_model(name):
    """The task's model with the parameters of the real system."""
    model = nominal_model(load_task(name), smoothing=Exact())
    truth = {
        "restitution.ball": 0.0 if name == "ball_slide" else real.RESTITUTION,
        "friction.ball": real.FRICTION,
        "gravity": real.GRAVITY / 9.81,
    }
    theta = [truth.get(p.name, x) for p, x in zip(model.scene.parameters, model.parameters, strict=True)]
    return model.with_parameters(np.array(theta))


def action(name):
    """The solution in units of the action."""
    throw, speed = SOLUTIONS[name]
    low, high = np.transpose([throw.speed_x, throw.speed_z])
    return torch.from_numpy(2 * (np.array(speed) - low) / (high - low) - 1)


@EACH
def test_a_throw_is_one_step(name):
    task = load_task(name)
    mdp, (throw, speed) = task.mdp(), SOLUTIONS[name]
    q, v = mdp.reset(3, torch.Generator().manual_seed(0))
    assert (q[:, :2] - torch.tensor(throw.start)).abs().max() <= throws.SPREAD
    assert not v.any()
    after_q, after_v, u = mdp.act(q, v, action(name).expand(3, 2))
    assert torch.equal(after_q, q)
    assert np.allclose(after_v, [*speed, 0.0])
    assert u.shape == (3, 0)
    corner = mdp.act(q, v, torch.tensor([[-1.0, 1.0]] * 3).double())[1]
    assert corner[0].tolist() == [throw.speed_x[0], throw.speed_z[1], 0.0]
    assert mdp.episode_steps == 1
    assert mdp.repeat * task.control_dt == pytest.approx(mdp.dt)
    there = torch.tensor([[*throw.goal, 0.0], [throw.goal[0] + 0.3, throw.goal[1] - 0.4, 1.0]], dtype=torch.float64)
    assert mdp.reward(q, v, v, there, there).tolist() == pytest.approx([0.0, -0.25])
    assert mdp.info(q, v, v, there, there)["distance"].tolist() == pytest.approx([0.0, 0.5])
    assert mdp.terminated(there, there).all()


@EACH
def test_no_throw_reaches_its_goal_without_contact(name):
    """Even the highest throw would be below ground at the end; where the goal is behind, the wall is needed too."""
    throw, _ = SOLUTIONS[name]
    t = throw.duration
    height = throw.start[1] + throws.SPREAD + throw.speed_z[1] * t - real.GRAVITY * t**2 / 2
    assert height < 0
    if name == "ball_throw":
        assert throw.goal[0] < throw.start[0] + throw.speed_x[0] * t


@EACH
def test_the_goal_can_be_reached_in_the_real_system_and_in_its_model(name):
    task = load_task(name)
    chosen = action(name).float()
    mdp = task.mdp()
    world = evaluate_real(lambda o: chosen.expand(len(o), 2), mdp, task.system, episodes=4, keep=True)
    assert np.sqrt(-world.returns).min() < 0.05
    assert (world.lengths == 1).all()
    assert len(world.q[0]) == mdp.repeat + 1
    model = evaluate_model(lambda o: chosen.expand(len(o), 2), mdp, true_model(name), episodes=4)
    assert np.sqrt(-model.returns) == pytest.approx(np.sqrt(-world.returns), abs=0.04)


def test_what_descent_meets():
    """Pathwise gradients: a plateau before the wall, and a bank shot whose cliff lies between start and goal."""
    model, mdp = true_model("ball_slide"), load_task("ball_slide").mdp()
    q, v = mdp.reset(1, torch.Generator().manual_seed(0))
    a = torch.tensor([[0.3, 0.0]], dtype=torch.float64, requires_grad=True)
    assert end(model, mdp, q, v, a)[0].item() == pytest.approx(real.WALL_X - real.WALL_RADIUS - real.RADIUS, abs=1e-3)
    end(model, mdp, q, v, a)[0].backward()
    assert a.grad.abs().max() < 1e-3
    model, mdp = true_model("ball_throw"), load_task("ball_throw").mdp()
    q, v = mdp.reset(1, torch.Generator().manual_seed(0))
    low, high = (end(model, mdp, q, v, torch.tensor([[0.0, z]]).double())[0].item() for z in (-0.2, 0.2))
    assert low > real.WALL_X, "over the wall"
    assert high < 0.0, "back from the wall"


def end(model, mdp, q, v, a):
    """The ball's last place."""
    q, v, u = mdp.act(q, v, a)
    for _ in range(mdp.repeat):
        q, v = model.step(q, v, u)
    return q[0]


def test_recordings_of_the_variants():
    """The inelastic ball keeps nothing of its normal speed."""
    log = load_task("ball_slide").record(300, seed=0)
    assert log.source["system"] == "ball_slide"
    landing = (log.v[:, 1] < -1.0) & (log.q_next[:, 1] <= real.RADIUS)
    assert landing.sum() >= 2
    assert np.abs(log.v_next[landing, 1]).max() < 1e-9
