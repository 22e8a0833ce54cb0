"""Our dm_walker_run and dm_cheetah_run are the Control Suite's: same observations, rewards, trajectories and resets."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cmbrl.envs.of_task import recorded
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task

pytest.importorskip("dm_control")
ROBOTS = {"dm_walker_run": "walker", "dm_cheetah_run": "cheetah"}


@pytest.fixture
def suite(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")  # nothing is rendered
    return pytest.importorskip("dm_control.suite")


def rows(data):
    return tuple(torch.from_numpy(np.array(x))[None] for x in (data.qpos, data.qvel))


@pytest.mark.parametrize(("name", "domain"), ROBOTS.items())
def test_an_episode_is_the_suites(suite, name, domain):
    task = load_task(name)
    mdp, system = task.mdp(), task.system()
    environment = suite.load(domain, "run", task_kwargs={"random": 0})
    environment.reset()
    data, rng = environment.physics.data, np.random.default_rng(0)
    system.reset(data.qpos, data.qvel)
    system.data.qacc_warmstart[:] = data.qacc_warmstart
    state = rows(data)
    assert (environment.control_timestep(), mdp.episode_steps) == (pytest.approx(mdp.dt), 1000)
    for _ in range(150):
        action = rng.uniform(-1, 1, mdp.actions)
        told = environment.step(action)
        assert np.array_equal(np.concatenate(system.step(action)), np.concatenate([data.qpos, data.qvel]))
        after = rows(data)
        observed = np.concatenate([np.ravel(x) for x in told.observation.values()])
        assert np.abs(mdp.observe(*after)[0].numpy() - observed).max() < 1e-12
        assert abs(mdp.reward(*state, torch.from_numpy(action)[None], *after).item() - told.reward) < 1e-12
        state = after


@pytest.mark.parametrize(("name", "domain"), ROBOTS.items())
def test_resets_are_drawn_as_the_suites(suite, name, domain):
    q, v = load_task(name).mdp().reset(300, torch.Generator().manual_seed(0))
    environment = suite.load(domain, "run", task_kwargs={"random": 1})
    drawn = []
    for _ in range(300):
        environment.reset()
        drawn.append(np.concatenate([environment.physics.data.qpos, environment.physics.data.qvel]))
    ours, theirs = torch.cat([q, v], dim=1).numpy(), np.array(drawn)
    assert all(distance(a, b) < 0.17 for a, b in zip(ours.T, theirs.T, strict=True))  # 1 in 3,000 by chance


def distance(a, b):
    """Kolmogorov and Smirnov's, between two samples."""
    at = np.concatenate([a, b])
    below = [np.searchsorted(np.sort(x), at, side="right") / len(x) for x in (a, b)]
    return np.abs(below[0] - below[1]).max()


@pytest.mark.parametrize("name", ROBOTS)
def test_rewards_pass_gradients_to_actions(name):
    task = load_task(name)
    mdp, model = task.mdp(), nominal_model(task, threads=1)
    q, v = mdp.reset(8, torch.Generator().manual_seed(0))
    if name == "dm_cheetah_run":
        v[:, 0] = 3.0  # its reward is flat backwards
    action = torch.zeros(8, mdp.actions, dtype=torch.float64, requires_grad=True)
    q_next, v_next = model.step(q, v, action)
    total = mdp.reward(q, v, action, q_next, v_next).sum()
    (gradient,) = torch.autograd.grad(total, action)
    direction = torch.randn(action.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def at(size):
        with torch.no_grad():
            u = action + size * direction
            return float(mdp.reward(q, v, u, *model.step(q, v, u)).sum())

    slope = (at(1e-6) - at(-1e-6)) / 2e-6
    assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-4)
    assert gradient.abs().sum() > 0


def test_a_log_of_random_actions():
    log = recorded(load_task("dm_walker_run")).record(30, seed=0)
    assert (len(log), log.q.shape[1], log.u.shape[1]) == (30, 9, 6)
    assert log.dt == pytest.approx(0.025)
