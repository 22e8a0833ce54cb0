"""SHAC's parts against closed forms, and that it learns."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import cmbrl
from cmbrl.envs.evaluation import evaluate_model
from cmbrl.envs.simulation import Simulation
from cmbrl.registry import load_task
from cmbrl.train.shac import SHAC, SHACConfig, Tamed, at_drive, gradient_variance
from cmbrl.train.windows.lost_gradients import LostGradients
from cmbrl.train.windows.peak import Peak

from . import slider

pytest.importorskip("gymnasium", reason="the hopper's MJCF is Gymnasium's")
SMALL = SHACConfig(iterations=10, environments=6, horizon=5, actor_hidden=(16,), critic_hidden=(16,), clip=float("inf"))


def make(config: SHACConfig = SMALL, seed: int = 0) -> SHAC:
    task = load_task("hopper")
    model = cmbrl.ComplementarityModel(task.load_scene(), smoothing=cmbrl.Barrier(1e-4), **task.model_options())
    return SHAC(task.mdp(), model, config, seed)


def valued(trainer: SHAC) -> None:
    """Gives values a size, which a critic learns from its first window: until then all are 0."""
    trainer.critic.units.deviation = torch.tensor(100.0)


def backward(trainer: SHAC) -> list:
    steps = trainer.roll(0.0)
    trainer.loss(steps).backward()
    return steps


def test_gradients_of_single_episodes_have_the_mean_that_autograd_finds():
    from cmbrl.gradients.per_sample import per_sample_gradients

    trainer = make()
    steps = backward(trainer)
    observations = torch.stack([s.observation.detach().float() for s in steps], dim=1)
    messages = torch.stack([at_drive(s.action) for s in steps], dim=1)
    policy = trainer.policy
    rows = per_sample_gradients(policy.net, policy.normaliser(observations), messages)
    found = torch.cat([p.grad.flatten() for p in policy.net.parameters()])
    torch.testing.assert_close(rows.sum(dim=0), found, rtol=1e-4, atol=1e-5 * float(found.abs().max()))
    expected = (rows * len(rows)).var(dim=0).sum()
    assert gradient_variance(policy, steps) == pytest.approx(float(expected), rel=1e-5)


def test_the_loss_s_derivative_in_an_action_is_that_of_differences():
    """Through dynamics, reward, shaping and the critic at the window's end; noise off, so that a window repeats."""
    config = replace(SMALL, noise_linear=0.0, noise_angular=0.0, tame=float("inf"))
    trainer = make(config)
    valued(trainer)
    start, random = trainer.simulation.state(), trainer.generator.get_state()
    steps = backward(trainer)
    k, row, joint, step = 1, 2, 1, 1e-3

    def loss(change: float) -> float:
        """Of the same window with that one action moved; the policy answers what comes of it."""
        trainer.simulation.restore(start)
        trainer.generator.set_state(random)
        taken = []
        with torch.no_grad():
            shape = config.horizon, config.environments, 3
            noise = config.noise_std(0.0) * torch.randn(shape, generator=trainer.generator)
            for j in range(config.horizon):
                observation = trainer.simulation.observe()
                action = trainer.policy.sample(observation.float(), noise[j])
                action[row, joint] += change * (j == k)
                taken.append(trainer.simulation.step(observation, action))
            return float(trainer.loss(taken))

    # float32 values of the critic limit the differences
    difference = (loss(step) - loss(-step)) / (2 * step)
    assert float(steps[k].action.grad[row, joint]) == pytest.approx(difference, rel=2e-2, abs=1e-4)


def test_restraint_pulls_outputs_back_from_where_tanh_is_flat():
    """Nothing within +-1, the square of the excess beyond; its derivative is that of differences."""
    trainer = make(replace(SMALL, saturation=0.5))
    steps, last = trainer.roll(0.0), trainer.policy.net[-1]
    assert trainer.restraint(steps) == 0
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.tensor([0.9, -3.0, 1.5]))
    cost = trainer.restraint(steps)
    assert float(cost.detach()) == pytest.approx(0.5 * (2.0**2 + 0.5**2))
    (slope,) = torch.autograd.grad(cost, last.bias)
    assert slope.tolist() == pytest.approx([0.0, -0.5 * 4.0, 0.5 * 1.0])
    trainer.gradient(0.0)
    assert last.bias.grad[1] < -1.5, "a part of the update"


def test_episodes_grow_until_half_of_the_updates_are_done(tmp_path):
    """The limits that episodes meet; the first ones end at different times all the same."""
    config = replace(SMALL, iterations=20, environments=64, horizon=1, episode_steps=12, episode_steps_start=2)
    model = cmbrl.ComplementarityModel(slider.scene(tmp_path), time_step=slider.DT)
    trainer = SHAC(slider.mdp(), model, config, seed=0)
    assert trainer.simulation.age.unique().tolist() == [0, 1]
    limits = []
    for _ in range(20):
        trainer.update()
        limits.append(trainer.simulation.mdp.episode_steps)
    assert limits[:10] == list(range(2, 12))
    assert limits[10:] == 10 * [12]
    assert trainer.mdp.episode_steps == 12, "trials last as long as an episode"


def test_td_lambda_targets_are_the_weighted_sums_of_n_step_returns():
    trainer = make()
    valued(trainer)
    c = trainer.config
    steps = trainer.roll(0.0)
    _, targets = trainer.critic.targets(steps)
    assert not any((s.terminated | s.truncated).any() for s in steps)
    values = [trainer.critic.value(s.next_observation.detach().float()).detach() for s in steps]
    rewards = [(s.reward + s.shaping).detach().float() for s in steps]

    def n_step(n: int) -> torch.Tensor:
        return sum(c.discount**k * rewards[k] for k in range(n)) + c.discount**n * values[n - 1]

    last = len(steps)
    weighted = sum((1 - c.trace) * c.trace ** (n - 1) * n_step(n) for n in range(1, last))
    expected = weighted + c.trace ** (last - 1) * n_step(last)
    torch.testing.assert_close(targets[: len(expected)], expected, rtol=1e-4, atol=1e-3)


def test_tamed_cuts_long_rows_to_the_median_s_multiple_and_nothing_else():
    q, v = (torch.zeros(5, 1, dtype=torch.float64, requires_grad=True) for _ in range(2))
    lengths = torch.tensor([1.0, 2.0, 3.0, 100.0, float("nan")], dtype=torch.float64)[:, None]
    lost = LostGradients()
    out_q, _ = Tamed.apply(q, v, 4.0, lost)
    out_q.backward(lengths)
    torch.testing.assert_close(q.grad[:, 0], torch.tensor([1.0, 2.0, 3.0, 8.0, 0.0], dtype=torch.float64))
    assert lost.rows["states"] == [5, 1]
    assert lost.end_update() == 0.2
    assert lost.end_update() == 0.0


def test_trials_are_of_whole_episodes_and_not_of_training_s_shorter_ones(tmp_path):
    """A policy that falls later than training lasts would be said to stand."""
    model = cmbrl.ComplementarityModel(slider.scene(tmp_path), time_step=slider.DT)
    config = SHACConfig(iterations=4, environments=8, horizon=4, episode_steps=10)
    trainer = SHAC(slider.mdp(episode_steps=200), model, config)
    assert trainer.mdp.episode_steps == 10
    shares = trainer.failed_trials()
    assert trainer.earned["no action"] > 10.0  # more than ten steps can earn
    assert shares["draws"] > 0.9  # without friction it leaves the rail, in seconds


@pytest.mark.parametrize("optimiser", ["adam", "muon"])
def test_it_learns_to_move(optimiser):
    config = SHACConfig(iterations=60, environments=32, horizon=16, optimiser=optimiser)
    trainer = make(config)
    before = evaluate_model(trainer.policy, trainer.mdp, trainer.model, 4, seed=1).returns.mean()
    for _ in range(config.iterations):
        metrics = trainer.update()
    after = evaluate_model(trainer.policy, trainer.mdp, trainer.model, 4, seed=1).returns.mean()
    assert metrics["steps"] == 60 * 32 * 16
    assert after > 4 * before


@pytest.mark.parametrize("spoilt", [-5.0, 5.0, 0.0])
def test_a_run_that_loses_late_what_it_learned_goes_back(spoilt: float):
    config = SHACConfig(iterations=80, environments=32, horizon=16, variance_every=1000)
    trainer = make(config)
    for k in range(config.iterations):
        if spoilt and k == 60:
            with torch.no_grad():
                trainer.policy.net[-1].weight.zero_()
                trainer.policy.net[-1].bias.fill_(spoilt)  # full torque
        trainer.update()
    assert bool(trainer.returns_to) == bool(spoilt)
    assert all(45 <= to <= 60 < update for update, to in trainer.returns_to)
    assert (
        evaluate_model(trainer.policy, trainer.mdp, trainer.model, 16, seed=1).returns.mean() > 400
    )  # spoilt: below 40


def test_a_run_that_ends_below_its_peak_keeps_that_policy(monkeypatch):
    config = replace(SMALL, iterations=4)
    trainer = make(config)
    held = {name: value + 1.0 for name, value in trainer.policy.state_dict().items()}
    earned = iter((1.0, 2.0))
    monkeypatch.setattr(trainer, "_earned", lambda: next(earned))
    for _ in range(config.iterations - 1):
        trainer.update()
    trainer.schedule.peak.best, trainer.schedule.peak.mean, trainer.schedule.peak.seen = 9.0, 1.0, 50
    trainer.schedule.peak.iteration, trainer.schedule.peak.learner = 2, {"policy": held}
    trainer.update()
    assert trainer.kept == 2
    assert all(torch.equal(value, held[name]) for name, value in trainer.policy.state_dict().items())


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_peak_of_returns(sign: float):
    """A mean over the last updates; lost is what has fallen by a tenth of the best, also of costs."""
    peak, net = Peak(100), torch.nn.Linear(1, 1).requires_grad_(False)
    for k in range(60):
        net.weight.fill_(float(k))
        peak.take(k, sign * 50.0 + (k if k < 30 else 90.0 - 2 * k), lambda: {"policy": net.state_dict()})
    assert peak.lost
    assert 20 <= peak.iteration <= 40
    assert float(peak.learner["policy"]["weight"]) == peak.iteration
    other = Peak(100)
    other.restore(peak.state())
    assert (other.best, other.mean) == (peak.best, peak.mean)
    assert not other.give_back(net, lambda: 1.0)  # the last one earns as much
    assert float(net.weight) == 59
    assert other.give_back(net, lambda: -float(net.weight))
    assert float(net.weight) == peak.iteration


def test_returns_tell_of_a_learner_only_when_its_own_episodes_have_ended():
    """Where an episode lasts 20 updates the run is not taken back again before, nor is a newer learner held."""
    peak, net = Peak(400, episode=20.0), torch.nn.Linear(1, 1).requires_grad_(False)

    def take(updates: range, returned: float) -> None:
        for k in updates:
            net.weight.fill_(float(k))
            peak.take(k, returned, lambda: {"policy": net.state_dict()})

    take(range(1, 100), 50.0)
    take(range(100, 103), 60.0)
    assert peak.iteration <= 80
    take(range(103, 130), 10.0)
    assert peak.lost
    peak.back(129)
    take(range(130, 150), 10.0)
    assert not peak.lost
    assert peak.seen == 0, "of the learner that was left"
    take(range(150, 190), 60.0)
    assert not peak.lost
    assert Peak(4000, episode=5.0).span == 80
    assert Peak(80, episode=62.5).span == 10, "a short run is not all span"


def test_costs_near_zero_are_lost_by_a_share_of_what_was_learned():
    """Returns of -1.2 after -1 are noise where no action earns -50, and a loss where it earns as little."""
    peak = Peak(100)
    for k in range(60):
        peak.take(k, -1.0 if k < 30 else -1.2, dict)
    assert peak.lost
    assert not Peak(100).lost_from(lambda: pytest.fail("nothing is lost"))
    other = Peak(100)
    other.restore(peak.state())
    assert not peak.lost_from(lambda: -50.0)
    assert other.lost_from(lambda: -1.3)
    again = Peak(100)
    again.restore(peak.state())
    assert again.idle == -50.0
    for k in range(60, 100):
        peak.take(k, -7.0, dict)
    assert peak.lost_from(lambda: pytest.fail("it is known"))


def test_a_run_that_went_back_just_before_its_end_keeps_the_better_policy():
    """Its last returns do not tell yet; before it goes back, a run that is too young to tell is left alone."""
    peak, net = Peak(100), torch.nn.Linear(1, 1).requires_grad_(False)
    assert not peak.give_back(net, lambda: pytest.fail("there is no peak"))
    for k in range(90):
        net.weight.fill_(float(k))
        peak.take(k, 50.0 if k < 60 else 10.0, lambda: {"policy": net.state_dict()})
    peak.back(89)
    net.weight.fill_(99.0)
    assert peak.open
    assert not peak.lost
    assert not peak.give_back(net, lambda: float(net.weight))
    assert float(net.weight) == 99
    assert peak.give_back(net, lambda: -float(net.weight))
    assert float(net.weight) == peak.iteration < 60


def test_returns_are_of_whole_episodes(tmp_path):
    """Episodes begin at different ages: what is left of the first ones would look like little cost."""
    model = cmbrl.ComplementarityModel(slider.scene(tmp_path), time_step=slider.DT)
    held = replace(
        slider.mdp(episode_steps=12),
        reward=lambda q, v, action, q_next, v_next: -torch.ones_like(q[:, 0]),
        terminated=lambda q, v: torch.zeros(len(q), dtype=torch.bool),
    )
    simulation = Simulation(held, model, 8, seed=1, stagger=True)
    assert simulation.age.any()
    for k in range(30):
        if k == 10:
            simulation.restore(simulation.state())
        simulation.step(simulation.observe(), torch.zeros(8, 1))
    assert simulation.finished
    assert set(simulation.finished) == {(-12.0, 12)}


class Exploding:
    """A block whose episode 3 is thrown away at each step, faster than anything moves and finite."""

    name, dt = "exploding", slider.DT

    def step(self, q, v, u):
        v = v + slider.DT * u
        thrown = torch.zeros(len(v), 1, dtype=v.dtype)
        thrown[3] = 1e150
        return q + slider.DT * v + thrown, v + thrown


def test_an_episode_that_explodes_leaves_nothing_behind():
    """No mean or variance of observations, no weight, no return keeps a trace of states that are huge but finite."""
    config = replace(SMALL, iterations=4, environments=8, noise_linear=0.0, noise_angular=0.0)
    boundless = replace(slider.mdp(), terminated=lambda q, v: torch.zeros(len(q), dtype=torch.bool))
    trainer = SHAC(boundless, Exploding(), config, seed=0)
    for _ in range(4):
        metrics = trainer.update()
        assert metrics["gradient_norm"] < 1e3
        assert metrics["critic_loss"] < 1e3
    assert trainer.policy.normaliser.variance.max() < 10
    assert all(bool(x.isfinite().all()) for x in trainer.policy.parameters())
    assert all(abs(gain) < 100 for gain, _ in trainer.simulation.finished)
    assert min(length for _, length in trainer.simulation.finished) == 1
