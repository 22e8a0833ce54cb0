"""Our Gymnasium ids: Gymnasium's and Stable-Baselines3's own checkers, and the real ones against the originals."""

from __future__ import annotations

import warnings
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
import torch

from cmbrl import UserError, registry
from cmbrl.registry import load_task

pytest.importorskip("gymnasium")
import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from torch.overrides import TorchFunctionMode

from cmbrl.envs.gymnasium_env import MDPEnv
from cmbrl.envs.registration import IDS, make_real, register, register_all
from cmbrl.errors import MissingPackage
from cmbrl.fitting import FitResult
from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.models.named import named_model, nominal_model

ALL = pytest.mark.parametrize("name", IDS)


@pytest.fixture(autouse=True)
def _without_graphics(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)


def test_every_task_with_a_process_has_its_ids():
    assert {"cmbrl/Hopper-v0", "cmbrl/HopperReal-v0", "cmbrl/Cheetah-v0", "cmbrl/CheetahReal-v0"} <= set(IDS)
    assert not any("Cube" in name for name in IDS)


@ALL
def test_gymnasiums_checker_passes(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*Box observation space (min|max)imum value is.*infinity")
        check_env(gymnasium.make(name, render_mode="rgb_array").unwrapped)


@ALL
def test_stable_baselines_checker_passes(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gymnasium.make(name))


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_stable_baselines_learns_on_a_single_environment(algorithm):
    sb3 = pytest.importorskip("stable_baselines3")
    env = gymnasium.make("cmbrl/HopperReal-v0")
    options = {"n_steps": 64} if algorithm == "PPO" else {"learning_starts": 60, "buffer_size": 200}
    learner = getattr(sb3, algorithm)("MlpPolicy", env, seed=0, device="cpu", **options).learn(128)
    assert learner.num_timesteps == 128
    assert len(learner.ep_info_buffer) > 0


def test_the_real_hopper_is_gymnasiums():
    """From the same state and with the same actions: the same observations, rewards, ends and infos."""
    ours, theirs = gymnasium.make("cmbrl/HopperReal-v0"), gymnasium.make("Hopper-v5")
    theirs.reset(seed=0)
    observation, _ = ours.reset(seed=0)
    inner = ours.unwrapped
    theirs.unwrapped.set_state(inner._q[0].numpy(), inner._v[0].numpy())
    rng = np.random.default_rng(0)
    ended = False
    while not ended:
        action = rng.uniform(-1, 1, 3)
        observation, reward, ended, truncated, info = ours.step(action)
        o, r, e, _, i = theirs.step(action)
        assert np.array_equal(observation, o)
        assert reward == pytest.approx(r, abs=1e-12)
        assert ended == e
        assert not truncated
        for key, value in info.items():
            assert value == pytest.approx(i[key], abs=1e-12)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space


@pytest.mark.parametrize("name", ["cmbrl/Hopper-v0", "cmbrl/HopperReal-v0"])
def test_a_vector_row_is_a_single_environment(name):
    """Rows started from given states move as single environments do, until they end and are restarted in that step."""
    single, many = gymnasium.make(name).unwrapped, gymnasium.make_vec(name, num_envs=2)
    assert many.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    first, _ = many.reset(seed=3)
    single.reset(seed=0)
    single._q, single._v = many.simulation.q[1:].clone(), many.simulation.v[1:].clone()
    rng = np.random.default_rng(1)
    ended = False
    while not ended:
        actions = rng.uniform(-1, 1, (2, 3)).astype(np.float32)
        observations, rewards, terminated, truncated, infos = many.step(actions)
        observation, reward, ended, _, _ = single.step(actions[1])
        assert rewards[1] == pytest.approx(reward, abs=1e-9)
        assert terminated[1] == ended
        last = infos["final_obs"][1] if ended else observations[1]
        assert np.allclose(last, observation, atol=1e-9)
    assert infos["_final_obs"][1]
    assert not truncated[1]
    assert np.abs(observations[1] - first[1]).max() < 0.02, "a fresh start"
    again, _ = many.reset(seed=3)
    assert np.array_equal(again, first)
    assert not np.array_equal(many.reset()[0], first)


def test_time_limit_and_seeds():
    task = load_task("hopper")
    env = MDPEnv(replace(task.mdp(), episode_steps=3), nominal_model(task), task.scene_path)
    first, _ = env.reset(seed=1)
    ends = [env.step(np.zeros(3))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]
    second, _ = env.reset()
    assert not np.array_equal(first, second)
    assert np.array_equal(env.reset(seed=1)[0], first)
    assert np.array_equal(env.reset()[0], second)


def test_actions_are_clipped_and_a_lost_state_ends_the_episode():
    task = load_task("hopper")
    env = MDPEnv(task.mdp(), nominal_model(task), task.scene_path)
    env.reset(seed=0)
    a = env.step(np.full(3, 5.0))[0]
    env.reset(seed=0)
    assert np.array_equal(env.step(np.ones(3))[0], a)
    env._q = torch.full((1, 6), torch.nan, dtype=torch.float64)
    observation, reward, terminated, truncated, _ = env.step(np.zeros(3))
    assert np.isfinite(observation).all()
    assert np.isfinite(reward)
    assert terminated
    assert not truncated


class _Counting(TorchFunctionMode):
    """Counts the calls of torch's functions and methods."""

    calls = 0

    def __torch_function__(self, func, types, args=(), kwargs=None):
        self.calls += 1
        return func(*args, **(kwargs or {}))


def test_a_step_of_one_environment_calls_torch_little():
    """Its time goes by the number of calls: 51 here, 115 when info and reward were evaluated apart."""
    env = gymnasium.make("cmbrl/Hopper-v0")
    env.reset(seed=0)
    env.step(np.zeros(3, np.float32))
    with _Counting() as counting:
        env.step(np.zeros(3, np.float32))
    assert counting.calls <= 60


def test_an_observation_that_is_the_state_comes_as_a_copy():
    """An observation is the caller's to change, even where the task returns the state itself."""
    task = load_task("hopper")
    env = MDPEnv(replace(task.mdp(), observe=lambda q, v: q), nominal_model(task), task.scene_path)
    env.reset(seed=0)
    observation = env.step(np.zeros(3))[0]
    before = env._q.clone()
    observation[:] = 7.0
    assert torch.equal(env._q, before)


def _save(model, folder):
    """A fit that found what the model has."""
    values = zip(model.scene.parameters, model.parameters.tolist(), strict=True)
    found = {p.name: FittedParameter(x, x, x, p.nominal, "nominal", p.unit) for p, x in values}
    about = {"data": {"transitions": 0, "episodes": 0}, "method": "random", "seed": 0, "horizon": 1, "candidates": 0}
    lists = {key: [] for key in ("flat_directions", "at_bound", "unseen", "gauge", "left_out")}
    report = {**about, **lists, "seconds": {"total": 0.0}, "loss": {}, "stopped": None, "selection": None}
    FitResult(model, found, report).save(folder)


def test_models_by_name_and_as_objects(tmp_path):
    task = load_task("hopper")
    model = nominal_model(task)
    highest = [p.high for p in model.scene.parameters]
    model = model.with_parameters(np.minimum(1.01 * model.parameters, highest))
    given = gymnasium.make("cmbrl/Hopper-v0", model=model)
    assert given.unwrapped.model is model
    assert isinstance(named_model("nominal", task), type(model))
    _save(model, tmp_path / "fit")
    fitted = gymnasium.make("cmbrl/Hopper-v0", model=tmp_path / "fit").unwrapped.model
    assert np.array_equal(fitted.parameters, model.parameters)
    with pytest.raises(UserError, match="another robot"):
        gymnasium.make("cmbrl/Cheetah-v0", model=tmp_path / "fit")
    _save(model.with_settings(substeps=8), tmp_path / "slow")
    slow = gymnasium.make("cmbrl/Hopper-v0", model=tmp_path / "slow").unwrapped.model
    assert (slow.substeps, slow.time_step) == (4, 0.002)  # at the task's control step
    with pytest.raises(UserError, match="neither a fit"):
        gymnasium.make("cmbrl/Hopper-v0", model=tmp_path)
    with pytest.raises(UserError, match="render_mode 'human'"):
        MDPEnv(task.mdp(), model, task.scene_path, render_mode="human")


def test_a_task_of_this_process_and_one_without_a_process(monkeypatch):
    monkeypatch.setattr(registry, "_registered", {})
    mine = replace(load_task("hopper"), name="my_hopper", system=None)
    registry.register(mine)
    assert register(mine) == ["cmbrl/MyHopper-v0"]
    assert register(load_task("cube_toss")) == []
    envs = gymnasium.make_vec("cmbrl/MyHopper-v0", num_envs=3)
    assert envs.reset(seed=0)[0].shape == (3, 11)
    del gymnasium.registry["cmbrl/MyHopper-v0"]


def test_the_time_limit_is_in_the_spec_and_can_be_shortened():
    for name, steps in (("cmbrl/Hopper-v0", 1000), ("cmbrl/CheetahDojoReal-v0", 80), ("cmbrl/BallThrow-v0", 1)):
        assert gymnasium.spec(name).max_episode_steps == steps
    env = gymnasium.make("cmbrl/Cheetah-v0", max_episode_steps=2)
    envs = gymnasium.make_vec("cmbrl/Cheetah-v0", num_envs=2, max_episode_steps=2)
    env.reset(seed=0)
    envs.reset(seed=0)
    ends = [env.step(np.zeros(6))[2:4] for _ in range(2)]
    many = [envs.step(np.zeros((2, 6), np.float32))[3].tolist() for _ in range(2)]
    assert ends == [(False, False), (False, True)]
    assert many == [[False, False], [True, True]]


def test_a_broken_task_takes_no_other_with_it(monkeypatch):
    """One whose module is missing, and one whose process cannot be made; what is not installed is no fault."""

    def broken():
        raise ValueError("no process")

    def not_installed():
        raise MissingPackage("pip install something")

    monkeypatch.setattr(registry, "_registered", {})
    registry.register(replace(load_task("hopper"), name="broken_process", mdp=broken))
    registry.register(replace(load_task("hopper"), name="not_installed", mdp=not_installed))
    installed = {"aaa": EntryPoint("aaa", "no_such_module:TASK", registry.GROUP), **registry._installed()}
    monkeypatch.setattr(registry, "_installed", lambda: installed)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = register_all()
    told = [str(w.message) for w in caught if str(w.message).startswith("no environment for")]
    assert len(told) == 2
    assert "no_such_module" in told[0]
    assert "no process" in told[1]
    assert set(found) == set(IDS)


def test_what_a_task_lacks_is_one_line(monkeypatch):
    monkeypatch.setattr(registry, "_registered", {})
    registry.register(replace(load_task("hopper"), name="no_system", system=None))
    with pytest.raises(UserError, match="has no real system"):
        make_real("no_system")
    with pytest.raises(UserError, match="has no reward"):
        make_real("cube_toss")


def test_pictures():
    env = gymnasium.make("cmbrl/Hopper-v0", render_mode="rgb_array", width=80, height=60)
    env.reset(seed=0)
    assert env.render().shape == (60, 80, 3)
    assert env.metadata["render_fps"] == 125
    real = gymnasium.make("cmbrl/HopperReal-v0", render_mode="rgb_array", width=80, height=60)
    real.reset(seed=0)
    assert np.array_equal(real.render(), env.render()), "the same state in the same scene"
    assert torch.equal(real.unwrapped._q, env.unwrapped._q)


def test_pictures_and_infos_of_a_vector_environment():
    """As those of single environments from the same states; of a step that ends an episode, apart."""
    many = gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=2, render_mode="rgb_array", width=80, height=60)
    single = gymnasium.make("cmbrl/Hopper-v0", render_mode="rgb_array", width=80, height=60).unwrapped
    many.reset(seed=3)
    single.reset(seed=0)
    single._q, single._v = many.simulation.q[1:].clone(), many.simulation.v[1:].clone()
    pictures = many.render()
    assert [x.shape for x in pictures] == [(60, 80, 3)] * 2
    assert np.array_equal(pictures[1], single.render())
    ended = False
    while not ended:
        infos = many.step(np.ones((2, 3), np.float32))[4]
        *_, ended, _, info = single.step(np.ones(3))
        told = infos["final_info"] if ended else infos
        assert info.keys() <= told.keys()
        for name, value in info.items():
            assert told[name][1] == pytest.approx(value, abs=1e-9)
            assert told[f"_{name}"][1]
            assert infos[f"_{name}"][1] == (not ended)
    assert infos["_final_info"][1]
    many.close()
    with pytest.raises(UserError, match="render_mode 'human'"):
        gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=2, render_mode="human")
    assert gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=2).render() is None


def test_a_wrong_call_is_one_line():
    env = gymnasium.make("cmbrl/Hopper-v0", render_mode="rgb_array").unwrapped
    for call in (env.render, lambda: env.step(np.zeros(3))):
        with pytest.raises(UserError, match=r"has not begun: call reset\(\)"):
            call()
    env.reset(seed=0)
    for action in (np.zeros(4), 0.5, np.zeros((1, 3))):
        with pytest.raises(UserError, match=r"the action has shape .*: give \(3,\)"):
            env.step(action)
    with pytest.raises(UserError, match=r"actions have shape \(3, 3\): give \(2, 3\)"):
        gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=2).step(np.zeros((3, 3)))
