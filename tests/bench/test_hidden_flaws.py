"""Hidden systems of the outside family: flaws that no file has act, and noise is seen but not lived."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.bench.studies.hidden import judge
from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.hidden.plan import OUTSIDE, SCENES
from cmbrl.bench.studies.mission.runs import random_log
from cmbrl.hidden.flaws import Flaws, play_of
from cmbrl.hidden.system import HiddenSystem
from cmbrl.registry import load_task

pytest.importorskip("gymnasium", reason="the robots are Gymnasium's")
pytestmark = pytest.mark.filterwarnings("ignore:compiler attribute")  # of the half-cheetah's file


@pytest.fixture(scope="module")
def files():
    return {scene: mujoco.MjModel.from_xml_path(load_task(scene).scene_path) for scene in SCENES}


@pytest.mark.parametrize("scene", SCENES)
def test_outside_has_the_flaws_that_it_says(files, scene):
    found, nominal = Hidden(scene, OUTSIDE, 2), files[scene]
    model, own = found.real
    assert model.opt.timestep == 1e-3
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    np.testing.assert_array_equal(model.body_mass, nominal.body_mass)
    np.testing.assert_array_equal(model.actuator_gear, nominal.actuator_gear)
    assert (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_FILTEREXACT).all()
    assert (model.actuator_dynprm[:, 0] == 0.02).all()
    steps = own.late * 1e-3 / found.task.control_dt
    assert 1.0 <= steps <= 2.0
    for k in range(nominal.nu):
        name = nominal.joint(int(nominal.actuator_trnid[k, 0])).name
        driven, play = model.joint(name), model.joint(play_of(name))
        low, high = play.range
        assert np.deg2rad(0.3) <= high - low <= np.deg2rad(1.0)
        assert low == -high
        assert play.stiffness[0] == play.frictionloss[0] == 0.0
        np.testing.assert_array_equal(driven.range, nominal.joint(name).range)
        assert driven.frictionloss[0] == found.file_like.joint(name).frictionloss[0] > 0
        assert driven.damping[0] == nominal.joint(name).damping[0]
    assert own.noise_q.shape == (nominal.nq,)
    assert (own.noise_v > own.noise_q).all()


def still(flaws_of, seed=0, scene="hopper"):
    """A robot of the outside family with some of its flaws alone."""
    found = Hidden(scene, OUTSIDE, 2)
    names = [found.file_like.joint(k).name for k in range(found.file_like.njnt)]
    return HiddenSystem(found.real[0], 0.008, names, flaws_of, np.random.default_rng(seed))


def test_delay_lag_and_backlash_act():
    q, v, u = np.array([0.0, 2.0, 0.0, -0.5, -0.5, 0.0]), np.zeros(6), np.ones(3)
    prompt, late = still(Flaws()), still(Flaws(late=12))
    for robot in (prompt, late):
        robot.reset(q, v)
        robot.step(u)
    assert prompt.data.act[0] == pytest.approx(1 - np.exp(-8 / 20), abs=1e-6)  # 8 ms of a lag of 20 ms
    assert not late.data.act.any()
    late.step(u)
    assert late.data.act[0] == pytest.approx(1 - np.exp(-4 / 20), abs=1e-6)  # 16 ms, less 12 of delay
    for _ in range(20):
        prompt.step(np.array([1.0, -1.0, 1.0]))
    plays = [prompt.data.joint(play_of(name)).qpos[0] for name in ("thigh_joint", "leg_joint", "foot_joint")]
    gaps = [prompt.model.joint(play_of(name)).range[1] for name in ("thigh_joint", "leg_joint", "foot_joint")]
    assert (np.abs(plays) > 1e-5).all()  # each has left its middle
    assert (np.abs(plays) < 2 * np.array(gaps)).all()  # and the stops hold


def test_noise_is_seen_and_not_lived():
    noise = np.full(6, 1e-3)
    noisy, quiet = still(Flaws(noise_q=noise, noise_v=10 * noise)), still(Flaws())
    q, v = np.array([0.0, 2.0, 0.0, -0.5, -0.5, 0.0]), np.zeros(6)
    seen = []
    for robot in (noisy, quiet):
        robot.reset(q, v)
        seen.append([np.hstack(robot.step(np.zeros(3))) for _ in range(300)])
    true = [np.hstack(state) for state in noisy.path[1:]]
    np.testing.assert_array_equal(true, seen[1])
    error = np.std(np.array(seen[0]) - true, axis=0)
    np.testing.assert_allclose(error, [*noise, *10 * noise], rtol=0.2)


def test_logs_and_draws_are_reproducible_and_noise_differs_between_robots():
    found = [Hidden("hopper", OUTSIDE, 5) for _ in range(2)]
    mdp = load_task("hopper").mdp()
    logs = [random_log(mdp, one.systems(), 30, 7) for one in found]
    for name in ("q", "v", "u", "q_next", "v_next"):
        np.testing.assert_array_equal(getattr(logs[0], name), getattr(logs[1], name))
    make = found[0].systems()
    robots = [make(), make()]
    q, v = np.array([0.0, 1.25, 0.0, 0.0, 0.0, 0.0]), np.zeros(6)
    for robot in robots:
        robot.reset(q, v)
    assert not np.array_equal(robots[0].step(np.zeros(3))[0], robots[1].step(np.zeros(3))[0])
    np.testing.assert_array_equal(robots[0].path[1][0], robots[1].path[1][0])


def test_returns_are_those_of_true_states():
    found, mdp = Hidden("hopper", OUTSIDE, 1), load_task("hopper").mdp()
    told = judge.real(lambda o: torch.full((len(o), 3), 0.5), mdp, found, 3)
    robot = found.systems()()
    q, v = mdp.reset(3, torch.Generator().manual_seed(9_000))
    robot.reset(q[0].numpy(), v[0].numpy())
    for _ in range(told["lengths"][0]):
        robot.step(np.full(3, 0.5))
    way = robot.path[-1][0][0] - robot.path[0][0][0]
    alive = told["lengths"][0] * (1 - 3 * 0.25e-3) - 1  # the step of the fall earns no survival
    assert told["falls"][0]
    assert told["last"][0] == pytest.approx(robot.path[-1][0].tolist())
    assert told["returns"][0] == pytest.approx(way / 0.008 + alive, abs=1e-6)
