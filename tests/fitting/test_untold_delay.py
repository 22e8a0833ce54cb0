"""Intervals allow for a delay that a fit has not taken, as far as the log does not rule it out."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data import read_trajectories
from cmbrl.fitting.outcome.identify import identify
from cmbrl.fitting.outcome.untold_delay import UntoldDelay, untold_delay_told
from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.search.space import Space
from cmbrl.scene import Parameter

ACTIVE = np.array([True, True, False])


@pytest.fixture
def space() -> Space:
    rotor = Parameter("armature.a", "armature", 1.0, 0.05, 20.0, "log", "")
    gear = Parameter("gear.a", "gear", 1.0, 0.2, 5.0, "log", "")
    return Space.of([rotor, gear, Parameter("delay.command", "delay", 0.0, 0.0, 0.05, "linear", "s")], [1.0, 1.0, 0.0])


def equations(alike: float, asks: float) -> NormalEquations:
    """A log whose delay looks like the rotor with a correlation ``alike``, and that asks for ``asks`` of it, in z."""
    hessian = np.array([[1.0, 0.0, alike], [0.0, 1.0, 0.1], [alike, 0.1, 1.0]])
    gradient = np.array([0.0, 0.0, -asks * (1.0 - alike**2 - 0.01)])
    episodes = gradient / 8 + 1e-6 * np.random.default_rng(0).normal(size=(8, 3))
    return NormalEquations(gradient, hessian, episodes, 1e4 * 1e-3, 1e-3)


@pytest.mark.parametrize("asks", [-0.5, 0.0, 0.02, 1.0])
def test_it_is_the_mean_over_delays_that_are_not_negative(space: Space, asks: float) -> None:
    told = equations(0.95, asks)
    late = UntoldDelay.of(space, np.zeros(3), ACTIVE, told)
    assert late is not None
    information = 1e4 * told.hessian + space.precision
    mean = -(np.linalg.inv(information) @ (1e4 * told.gradient))[2]
    spread = np.linalg.inv(1e4 * told.hessian / (1 + 20 * told.variance) + space.precision)
    drawn = mean + np.sqrt(spread[2, 2]) * np.random.default_rng(1).normal(size=2_000_000)
    drawn = drawn[drawn >= 0.0]
    follow = spread[:, 2] / spread[2, 2]
    if len(drawn) > 1000:
        np.testing.assert_allclose(late.covariance, np.outer(follow, follow) * np.mean(drawn**2), rtol=0.02)
    else:  # ruled out
        assert np.abs(late.covariance).max() < 1e-4


def test_intervals_reach_what_a_delay_would_make_of_a_rotor(space: Space) -> None:
    told, z = equations(0.95, 1.0), np.zeros(3)
    late, none = UntoldDelay.of(space, z, ACTIVE, told), np.zeros((3, 3))
    assert late is not None
    alone, beside = identify(space, z, ACTIVE, told, none), identify(space, z, ACTIVE, told, none, (), late.covariance)
    truth = space.theta(np.array([-0.95, -0.1, 1.0]))
    assert not alone.low[0] < truth[0] < alone.high[0]
    assert beside.low[0] < truth[0] < beside.high[0]
    np.testing.assert_array_equal(beside.covariance, alone.covariance)
    found = late.told(space, np.diag(alone.wide), dt=0.02)
    assert found is not None
    assert found["parameters"][0] == "armature.a"
    assert truth[2] < found["most"] < 0.02
    text = untold_delay_told({"untold_delay": found})
    assert text is not None
    assert "armature.a" in text
    assert late.told(space, np.diag(alone.wide), dt=1.0) is None


def test_there_is_none_where_the_delay_is_fitted(space: Space) -> None:
    assert UntoldDelay.of(space, np.zeros(3), np.array([True, True, True]), equations(0.9, 0.1)) is None
    assert UntoldDelay.of(space, np.zeros(3), np.zeros(3, dtype=bool), equations(0.9, 0.1)) is None
    assert untold_delay_told({}) is None


WHEEL = """<mujoco><option timestep=".005"/><worldbody><body><joint name="wheel" axis="0 1 0" armature=".02"
damping=".01"/><geom type="cylinder" size=".05 .02" mass=".1" euler="90 0 0"/></body></worldbody>
<actuator><velocity name="wheel" joint="wheel" kv=".5"/></actuator></mujoco>"""


def test_draws_have_a_delay_that_slow_commands_hide() -> None:
    """A wheel that is 30 ms late, by a fit that has taken a heavier rotor for it: a policy has to stand both."""
    model = mujoco.MjModel.from_xml_string(WHEEL)
    data, rows, rng = mujoco.MjData(model), [], np.random.default_rng(0)
    time = 0.02 * np.arange(600)
    command = sum(rng.uniform(1, 3) * np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) for f in (0.13, 0.3, 0.5))
    queue = [0.0] * 6
    for each in command:
        rows.append((data.qpos.copy(), data.qvel.copy()))
        for _ in range(4):
            queue.append(each)
            data.ctrl[:] = queue.pop(0)
            mujoco.mj_step(model, data)
    q, v = (np.array(part) for part in zip(*rows, strict=True))
    v += 0.02 * rng.normal(size=v.shape)
    log = read_trajectories(q, [len(q)], 0.02, v, command[:, None])
    scene = cmbrl.Scene.from_mjcf(WHEEL)
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), log, groups=["armature", "damping"], horizon=4)
    rotor = [p.name for p in scene.parameters].index("armature.wheel")
    assert found.parameters["armature.wheel"].value > 0.025
    drawn = found.uncertain_model(200)
    delays = drawn.candidates[:, [p.group for p in drawn.observer.parameters].index("delay") + len(scene.parameters)]
    assert delays.min() >= 0.0
    assert 0.025 < np.quantile(delays, 0.95) < 0.08
    late = drawn.candidates[(delays > 0.025) & (delays < 0.035), rotor]
    assert len(late)
    assert abs(late.mean() - 0.02) < 0.2 * (found.parameters["armature.wheel"].value - 0.02)  # the two go together
