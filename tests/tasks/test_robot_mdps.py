"""Our Hopper-v5 and HalfCheetah-v5 are Gymnasium's: same trajectories, observations, rewards, ends and resets."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cmbrl.tasks.cheetah import TASK as CHEETAH
from cmbrl.tasks.hopper import TASK as HOPPER

gymnasium = pytest.importorskip("gymnasium")
TASKS = pytest.mark.parametrize(
    ("task", "name"), [(HOPPER, "Hopper-v5"), (CHEETAH, "HalfCheetah-v5")], ids=["hopper", "cheetah"]
)


@pytest.fixture(autouse=True)
def _elsewhere(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # Gymnasium's loading of half_cheetah.xml leaves a log in the working folder


def row(x):
    return torch.from_numpy(np.array(x, dtype=float))[None]


@TASKS
def test_an_episode_is_gymnasiums(task, name):
    mdp, system = task.mdp(), task.system()
    env = gymnasium.make(name)
    data = env.unwrapped.data
    rng = np.random.default_rng(0)
    ends = []
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        q, v = row(data.qpos), row(data.qvel)
        system.reset(data.qpos, data.qvel)
        ended, t = False, 0
        while not ended and t < 150:
            assert np.array_equal(mdp.observe(q, v)[0], observation)
            u = rng.uniform(-1, 1, mdp.actions)
            observation, reward, ended, _, told = env.step(u)
            state = system.step(u)
            assert np.array_equal(state[0], data.qpos), "bit for bit"
            assert np.array_equal(state[1], data.qvel)
            q_next, v_next = map(row, state)
            assert mdp.reward(q, v, row(u), q_next, v_next).item() == pytest.approx(reward, abs=1e-12, rel=1e-12)
            for key, value in mdp.info(q, v, row(u), q_next, v_next).items():
                assert value.item() == pytest.approx(told[key], abs=1e-12), key
            assert mdp.terminated(q_next, v_next).item() == ended
            q, v, t = q_next, v_next, t + 1
        ends.append(ended)
    assert any(ends) == (task is HOPPER)
    assert mdp.episode_steps == env.spec.max_episode_steps
    assert mdp.dt == pytest.approx(env.unwrapped.dt)
    assert system.dt == pytest.approx(task.control_dt)


@TASKS
def test_resets_are_drawn_like_gymnasiums(task, name):
    """Same centre and bounds, or same deviation, coordinate by coordinate."""
    env = gymnasium.make(name).unwrapped
    theirs = []
    for seed in range(400):
        env.reset(seed=seed)
        theirs.append(np.concatenate([env.data.qpos, env.data.qvel]))
    ours = torch.cat(task.mdp().reset(4000, torch.Generator().manual_seed(0)), dim=1).numpy()
    spread = np.std(theirs, axis=0)
    assert np.allclose(ours.std(0), spread, rtol=0.15)
    assert np.allclose(ours.mean(0), np.mean(theirs, axis=0), atol=4 * spread.max() / 20)
    bounded = ours[:, : env.model.nq] - env.init_qpos
    assert np.abs(bounded).max() <= env._reset_noise_scale
    assert np.abs(bounded).max() > 0.99 * env._reset_noise_scale


def test_hopper_ends_where_gymnasiums_does():
    """States on either side of every bound of health."""
    env = gymnasium.make("Hopper-v5").unwrapped
    env.reset(seed=0)
    mdp = HOPPER.mdp()
    for index, values in {
        1: (0.7, 0.7 + 1e-9),
        2: (-0.2, 0.2, 0.2 - 1e-9),
        4: (-101.0, 99.0),
        9: (100.0, 99.9),
    }.items():
        for value in values:
            state = np.concatenate([env.init_qpos, env.init_qvel])
            state[index] = value
            env.data.qpos[:], env.data.qvel[:] = np.split(state, 2)
            assert mdp.terminated(row(state[:6]), row(state[6:])).item() == (not env.is_healthy), (index, value)
    assert mdp.terminated(row(np.full(6, np.nan)), row(np.zeros(6))).item()


def test_hopper_barrier_is_zero_where_it_is_safe_and_slopes_before_the_end():
    barrier = HOPPER.mdp().shaping
    q = torch.tensor([[0.0, 1.25, 0.0, 0, 0, 0], [0.0, 0.85, 0.0, 0, 0, 0], [0.0, 1.25, -0.18, 0, 0, 0]]).double()
    q.requires_grad_()
    value = barrier(q, torch.zeros(3, 6))
    assert value.tolist() == pytest.approx([0.0, -5.0, -3.0])
    value.sum().backward()
    assert q.grad[1, 1] > 0
    assert q.grad[2, 2] > 0
