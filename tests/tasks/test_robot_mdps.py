"""Our Hopper, HalfCheetah, Walker2d and Ant are Gymnasium's: same trajectories, observations, rewards, ends, resets."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.envs.evaluation import evaluate_real
from cmbrl.envs.recording import Recording
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.models.named import nominal_model
from cmbrl.tasks.ant import TASK as ANT
from cmbrl.tasks.cheetah import TASK as CHEETAH
from cmbrl.tasks.hopper import TASK as HOPPER
from cmbrl.tasks.walker2d import TASK as WALKER

gymnasium = pytest.importorskip("gymnasium")
ROBOTS = {HOPPER: "Hopper-v5", CHEETAH: "HalfCheetah-v5", WALKER: "Walker2d-v5", ANT: "Ant-v5"}
TASKS = pytest.mark.parametrize(("task", "name"), ROBOTS.items(), ids=[task.name for task in ROBOTS])


@pytest.fixture(autouse=True)
def _elsewhere(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # Gymnasium's loading of half_cheetah.xml leaves a log in the working folder


def row(x):
    return torch.from_numpy(np.array(x, dtype=float))[None]


def state(task, system, q, v):
    """A state (nq,), (nv,) as the process has it, with what the real system feels."""
    q, v, mdp = row(q), row(v), task.mdp()
    if mdp.feel is None:
        return q, v
    felt = system.felt()
    return torch.cat([q, row(felt)], dim=1), v


@TASKS
def test_an_episode_is_gymnasiums(task, name):
    mdp, system = task.mdp(), task.system()
    env = gymnasium.make(name)
    data = env.unwrapped.data
    rng = np.random.default_rng(0)
    ends = []
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        system.reset(data.qpos, data.qvel)
        q, v = state(task, system, data.qpos, data.qvel)
        ended, t = False, 0
        while not ended and t < 150:
            assert np.array_equal(mdp.observe(q, v)[0], observation[: mdp.observations])
            u = rng.uniform(-1, 1, mdp.actions)
            observation, reward, ended, _, told = env.step(u)
            after = system.step(u)
            assert np.array_equal(after[0], data.qpos), "bit for bit"
            assert np.array_equal(after[1], data.qvel)
            q_next, v_next = state(task, system, *after)
            assert mdp.reward(q, v, row(u), q_next, v_next).item() == pytest.approx(reward, abs=1e-12, rel=1e-12)
            for key, value in mdp.info(q, v, row(u), q_next, v_next).items():
                assert value.item() == pytest.approx(told[key], abs=1e-12), key
            assert mdp.terminated(q_next, v_next).item() == ended
            q, v, t = q_next, v_next, t + 1
        ends.append(ended)
    assert any(ends) == (task is not CHEETAH)
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
    mdp = task.mdp()
    q, v = mdp.reset(4000, torch.Generator().manual_seed(0))
    ours = torch.cat([mdp.robot(q), v], dim=1).numpy()
    spread = np.std(theirs, axis=0)
    assert np.allclose(ours.std(0), spread, rtol=0.15)
    assert np.allclose(ours.mean(0), np.mean(theirs, axis=0), atol=4 * spread.max() / 20)
    bounded = ours[:, : env.model.nq] - env.init_qpos
    assert np.abs(bounded).max() <= env._reset_noise_scale
    assert np.abs(bounded).max() > 0.99 * env._reset_noise_scale


@TASKS
def test_an_evaluation_earns_what_gymnasium_pays(task, name):
    """Whole episodes of a policy through our evaluation, against the environment from the same start."""
    mdp = replace(task.mdp(), episode_steps=60)
    gains = torch.from_numpy(np.random.default_rng(1).normal(size=(mdp.observations, mdp.actions)))

    def actor(observation):  # a product of matrices may round by the number of rows, which the motion amplifies
        return torch.tanh((observation.double()[:, :, None] * gains).sum(dim=1)).float()

    found = evaluate_real(actor, mdp, task.system, 2, seed=3)
    env = gymnasium.make(name).unwrapped
    starts = mdp.reset(2, torch.Generator().manual_seed(3))
    for k, (q, v) in enumerate(zip(mdp.robot(starts[0]).numpy(), starts[1].numpy(), strict=True)):
        env.reset()
        mujoco.mj_resetData(env.model, env.data)
        env.set_state(q, v)
        total, ended, t = 0.0, False, 0
        observation = env._get_obs()
        while not ended and t < mdp.episode_steps:
            action = actor(torch.from_numpy(observation[None, : mdp.observations]).float())[0].double()
            observation, reward, ended, _, _ = env.step(action.numpy())
            total, t = total + reward, t + 1
        assert found.lengths[k] == t
        assert found.returns[k] == pytest.approx(total, abs=1e-6), "rounding of the start's quaternion grows"


@pytest.mark.parametrize("task", [WALKER, ANT], ids=lambda task: task.name)
def test_rewards_in_the_model_have_a_gradient_in_the_action(task):
    """Against central differences, over two steps of the nominal model."""
    mdp, model = replace(task.mdp(), shaping=None), nominal_model(task, threads=1)
    first = 0.3 * torch.randn(3, mdp.actions, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def total(action):
        simulation = Simulation(mdp, model, 3, seed=1)
        steps = [simulation.step(simulation.observe(), action) for _ in range(2)]
        assert not any(step.terminated.any() for step in steps)
        return sum(step.reward.sum() + step.next_observation.sum() for step in steps)

    action = first.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(total(action), action)
    push = torch.randn(gradient.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    difference = (total(first + 1e-6 * push) - total(first - 1e-6 * push)) / 2e-6
    assert float((gradient * push).sum()) == pytest.approx(float(difference), rel=1e-4)
    assert gradient.abs().min() > 0


def test_walker_ends_where_gymnasiums_does():
    """States on either side of every bound of health."""
    env = gymnasium.make("Walker2d-v5").unwrapped
    env.reset(seed=0)
    mdp = WALKER.mdp()
    for index, values in {1: (0.8, 0.8 + 1e-9, 2.0, 2.0 - 1e-9), 2: (-1.0, 1.0, 1.0 - 1e-9), 9: (500.0,)}.items():
        for value in values:
            whole = np.concatenate([env.init_qpos, env.init_qvel])
            whole[index] = value
            env.data.qpos[:], env.data.qvel[:] = np.split(whole, 2)
            assert mdp.terminated(row(whole[:9]), row(whole[9:])).item() == (not env.is_healthy), (index, value)
    assert mdp.terminated(row(np.full(9, np.nan)), row(np.zeros(9))).item()


def test_ant_ends_where_gymnasiums_does():
    """Both heights are healthy themselves; what is not finite is not."""
    env = gymnasium.make("Ant-v5").unwrapped
    env.reset(seed=0)
    mdp = ANT.mdp()
    heights = {2: (0.2, 0.2 - 1e-12, 1.0, 1.0 + 1e-12, np.nan), 20: (np.inf, 1e6)}
    for index, values in heights.items():
        for value in values:
            whole = np.concatenate([env.init_qpos, env.init_qvel])
            whole[index] = value
            env.data.qpos[:], env.data.qvel[:] = np.split(whole, [15])
            q = np.concatenate([whole[:15], np.zeros(mdp.memory)])
            assert mdp.terminated(row(q), row(whole[15:])).item() == (not env.is_healthy), (index, value)


def test_ants_steps_start_from_unit_quaternions():
    """Resets are not of unit length, steps are; logs hold the state from which a step starts."""
    mdp = ANT.mdp()
    robot = Recording(replace(mdp, episode_steps=5), ANT.system, seed=2)
    assert (robot.q[0, 3:7].norm() - 1).abs() > 1e-3
    costs = [-robot.step(row(np.full(8, 0.5)))["reward"].item() for _ in range(12)]
    assert len(set(costs)) == 12
    log = robot.log()
    assert log.q.shape == log.q_next.shape == (12, 15)
    log.check(ANT.load_scene(), dt=ANT.control_dt)
    assert np.allclose(np.linalg.norm(log.q[:, 3:7], axis=1), 1, atol=1e-12)
    q, v = mdp.reset(3, torch.Generator().manual_seed(0))
    q[1, 3:7] /= q[1, 3:7].norm()
    started, _, _ = mdp.act(q, v, torch.zeros(3, 8))
    assert torch.equal(started[1], q[1]), "as it is, so that a robot that is there goes on undisturbed"
    assert torch.allclose(started[:, 3:7].norm(dim=1), torch.ones(3).double())


def test_ants_contact_cost_is_the_real_systems():
    """The model knows no forces on bodies, the real system does; a process keeps what it feels."""
    mdp, system = ANT.mdp(), SystemBatch(ANT.system, 1)
    q, v = mdp.reset(1, torch.Generator().manual_seed(0))
    model_q, model_v = mdp.move(nominal_model(ANT, threads=1).step, *mdp.act(q, v, torch.zeros(1, 8).double()))
    assert torch.equal(model_q[:, 15:17], model_q[:, :2])
    assert model_q[0, 17] == 0
    cost = 0.0
    for _ in range(12):  # until it stands
        q, v = mdp.move(system.step, *mdp.act(q, v, torch.zeros(1, 8).double()))
        cost = max(cost, float(q[0, 17]))
    assert q.shape == (1, 18)
    assert 5e-4 < cost < 5e-4 * 78
    assert 0 < float((q[0, 15:17] - q[0, :2]).abs().max()) < 1e-3
    assert model_v.shape == (1, 14)


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
