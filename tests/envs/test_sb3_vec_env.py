"""Stable-Baselines3 on our batched simulation, on a model and on real systems."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cmbrl import UserError
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.tasks.hopper import TASK

pytest.importorskip("gymnasium")
pytest.importorskip("stable_baselines3")
import gymnasium
import stable_baselines3 as sb3
from stable_baselines3.common.vec_env import VecMonitor

from cmbrl.envs.sb3_vec_env import Sb3VecEnv


@pytest.fixture(scope="module")
def model():
    return ComplementarityModel(TASK.load_scene(), **TASK.model_options())


def worlds(model, count):
    return {"model": model, "real": SystemBatch(TASK.system, count)}


@pytest.mark.parametrize("world", ["model", "real"])
def test_a_step_is_the_simulations_and_ends_restart_with_the_last_observation_kept(model, world):
    count = 3
    env = Sb3VecEnv(Simulation(TASK.mdp(), worlds(model, count)[world], count, seed=1))
    same = Simulation(TASK.mdp(), worlds(model, count)[world], count, seed=1)
    env.seed(7)
    same.restart(7)
    assert np.array_equal(env.reset(), same.observe())
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(60):
        action = rng.uniform(-2, 2, (count, 3)).astype(np.float32)
        with torch.no_grad():
            step = same.step(same.observe(), torch.from_numpy(action.clip(-1, 1)))
        observation, reward, done, infos = env.step(action)
        assert np.array_equal(observation, same.observe())
        assert np.allclose(reward, step.reward, rtol=1e-6)
        assert np.array_equal(done, step.terminated)
        for k in np.flatnonzero(done):
            assert np.array_equal(infos[k]["terminal_observation"], step.next_observation[k])
            assert not infos[k]["TimeLimit.truncated"]
        ended += done.sum()
    assert ended > 0


def test_our_gymnasium_vector_environment_is_taken_and_others_are_refused():
    """Also behind a wrapper of Gymnasium's."""
    ours = gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=3)
    for envs in (ours, gymnasium.wrappers.vector.RecordEpisodeStatistics(ours)):
        taken = Sb3VecEnv(envs)
        assert taken.simulation is ours.unwrapped.simulation
        assert taken.reset().shape == (3, 11)
    others = gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync")
    with pytest.raises(UserError, match=r"not SyncVectorEnv.*make_vec") as error:
        Sb3VecEnv(others)
    assert "\n" not in str(error.value)


def test_the_time_limit_is_told_apart_from_a_fall(model):
    simulation = Simulation(TASK.mdp(), model, 2, seed=0)
    env = Sb3VecEnv(simulation)
    env.reset()
    simulation.age[1] = TASK.mdp().episode_steps - 1
    _, _, done, infos = env.step(np.zeros((2, 3), np.float32))
    assert done.tolist() == [False, True]
    assert infos[1]["TimeLimit.truncated"]
    assert not infos[0]["TimeLimit.truncated"]


def test_a_row_that_is_lost_ends_without_spoiling_what_is_learned_from(model):
    simulation = Simulation(TASK.mdp(), model, 2, seed=0)
    env = Sb3VecEnv(simulation)
    env.reset()
    simulation.v[0] = torch.nan
    observation, reward, done, infos = env.step(np.zeros((2, 3), np.float32))
    assert done.tolist() == [True, False]
    assert np.isfinite(observation).all()
    assert np.isfinite(reward).all()
    assert np.isfinite(infos[0]["terminal_observation"]).all()


def test_real_systems_go_on_undisturbed_and_are_reset_when_asked_for_another_state():
    batch = SystemBatch(TASK.system, 2)
    alone = TASK.system()
    q, v = TASK.mdp().reset(2, torch.Generator().manual_seed(0))
    alone.reset(q[1].numpy(), v[1].numpy())
    u = torch.full((2, 3), 0.5).double()
    for t in range(20):
        if t == 10:
            q[0], v[0] = TASK.mdp().reset(1, torch.Generator().manual_seed(1))
        q, v = batch.step(q, v, u)
        expected = alone.step(u[1].numpy())
        assert np.array_equal(q[1], expected[0]), "warm starts included"
        assert np.array_equal(v[1], expected[1])
    assert q[0, 0] != q[1, 0]


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
@pytest.mark.parametrize("world", ["model", "real"])
def test_stable_baselines_learns_on_it(model, algorithm, world):
    env = VecMonitor(Sb3VecEnv(Simulation(TASK.mdp(), worlds(model, 4)[world], 4)))
    options = {"n_steps": 32, "batch_size": 64} if algorithm == "PPO" else {"learning_starts": 64, "buffer_size": 500}
    learner = getattr(sb3, algorithm)("MlpPolicy", env, seed=0, device="cpu", **options)
    before = [p.clone() for p in learner.policy.parameters()]
    learner.learn(256)
    assert learner.num_timesteps == 256
    assert any(not torch.equal(a, b) for a, b in zip(before, learner.policy.parameters(), strict=True))
    assert len(learner.ep_info_buffer) > 0


def test_attributes_are_shared(model):
    env = Sb3VecEnv(Simulation(TASK.mdp(), model, 2))
    assert env.get_attr("render_mode", [0]) == [None]
    with pytest.raises(UserError, match="same in all"):
        env.set_attr("render_mode", "human", [0])
    with pytest.raises(UserError, match="no method 'jump'"):
        env.env_method("jump")
