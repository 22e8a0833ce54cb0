"""Biases, delay and lag between a log and the state: closed forms, and derivatives against finite differences."""

from pathlib import Path

import numpy as np
import pytest

from cmbrl import ComplementarityModel, Transitions, UserError
from cmbrl.fitting.search.space import Space
from cmbrl.models.between.late import late_response, response
from cmbrl.models.between.observation import Observation
from cmbrl.scene import Scene

ARM = """
<mujoco><worldbody><body>
  <joint name="a" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
  <body pos=".3 0 0"><joint name="b" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body>
</body></worldbody>
<actuator><position joint="a" kp="20" kv="1" gear="2"/><motor joint="b"/></actuator></mujoco>
"""


@pytest.fixture
def arm(tmp_path: Path) -> Scene:
    (tmp_path / "arm.xml").write_text(ARM)
    return Scene.from_mjcf(tmp_path / "arm.xml")


def random_log(scene: Scene, rows: int = 60) -> Transitions:
    draw = np.random.default_rng(0)
    q, u = 0.3 * draw.normal(size=(rows + 1, scene.nq)), draw.normal(size=(rows, scene.nu))
    zeros = np.zeros((rows, scene.nv))
    episode = np.arange(rows) // 20
    return Transitions(q=q[:-1], v=zeros, u=u, q_next=q[1:], v_next=zeros, dt=0.01, episode=episode)


def test_a_whole_delay_shifts_commands_and_a_lag_filters_them() -> None:
    np.testing.assert_allclose(response(0.02, 0.0, 0.01)[0], [0, 0, 0, 0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(response(0.015, 0.0, 0.01)[0], [0, 0, 0, 0.5, 0.5, 0], atol=1e-12)
    lag, dt = 0.03, 0.01
    time = np.linspace(0.0, dt, 20001)
    first = np.trapezoid(1.0 - np.exp(-time / lag), time) / dt  # mean of the response in the first step
    following, weights = np.split(response(0.0, lag, dt)[0], [2])
    assert not following.any()
    assert weights[0] == pytest.approx(first, rel=1e-8)
    np.testing.assert_allclose(weights[2:20] / weights[1:19], np.exp(-dt / lag), rtol=1e-9)
    assert weights.sum() == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize(
    ("ahead", "delay", "lag"),
    [(0.0, 0.0, 0.0), (0.0, 0.004, 0.0), (0.0, 0.013, 0.002), (0.0, 0.0, 0.02), (0.0, 0.027, 0.03), (0.004, 0.0, 0.0),
     (0.012, 0.001, 0.004), (0.004, 0.0, 0.02)],
)  # fmt: skip
@pytest.mark.parametrize("ramp", [0.0, 0.03])  # most of these commands are out of reach of the second one
def test_slopes_equal_differences(arm: Scene, ahead: float, delay: float, lag: float, ramp: float) -> None:
    log, between = random_log(arm), Observation.of(arm, 0.01, step=0.001)
    psi = np.array([0.03, -0.02, 0.01, 0.2, -0.04, 0.02, ramp, 0.7, 0.1, ahead, delay, lag])
    _, slope = between.controls(log, psi)
    for k in range(len(psi)):
        e = (
            1e-7 * (np.arange(len(psi)) == k) * (-1.0 if between.parameters[k].group == "ahead" else 1.0)
        )  # one-sided, as delay
        one_sided = (between.controls(log, psi + e)[0] - between.controls(log, psi)[0]) / e[k]
        np.testing.assert_allclose(slope[:, :, k], one_sided, rtol=1e-3, atol=5e-2)


def test_a_delay_as_long_as_its_bound_is_as_usual_as_none(arm: Scene) -> None:
    """A prior makes no two halves of a delay of 40 ms, nor shortens the lag of propellers, which is far longer."""
    offered = Observation.of(arm, 0.02).parameters
    space = Space.of(offered, np.zeros(len(offered)))
    late = space.columns(["delay", "lag"])
    np.testing.assert_allclose(space.sd[late], 0.06)
    np.testing.assert_allclose(space.high[late], [0.06, 0.6])


def test_a_servo_behind_a_biased_encoder(arm: Scene) -> None:
    """Its torque is that of the true angle with the target moved by the bias; a motor does not feel it."""
    bias = 0.05
    log, between = random_log(arm), Observation.of(arm, 0.01)
    seen = between.states(log, between.vector({"bias.a": bias, "bias.b": bias}))
    np.testing.assert_allclose(seen.q, log.q - bias)
    np.testing.assert_allclose(seen.u, log.u - [2.0 * bias, 0.0])


def test_a_servo_that_reads_the_true_angle(arm: Scene) -> None:
    """The bias is only that of the log: the control is what was commanded. A motor has no such zero."""
    log, between = random_log(arm), Observation.of(arm, 0.01)
    seen = between.states(log, between.vector({"bias.a": 0.05, "servo_zero.a": 0.05}))
    np.testing.assert_allclose(seen.q, log.q - [0.05, 0.0])
    np.testing.assert_allclose(seen.u, log.u)
    assert "servo_zero.b" not in {p.name for p in between.parameters}


def test_history_stays_within_the_episode(arm: Scene) -> None:
    """Before an episode a servo held its first target, and a motor was off."""
    log, between = random_log(arm), Observation.of(arm, 0.01)
    u = between.states(log, between.vector({"delay.command": 0.01})).u
    first = np.flatnonzero(np.r_[True, np.diff(log.episode) != 0])
    np.testing.assert_allclose(u[first], log.u[first] * [1.0, 0.0], atol=1e-12)
    rest = np.setdiff1d(np.arange(len(log)), first)
    np.testing.assert_allclose(u[rest], log.u[rest - 1], atol=1e-12)


def test_commands_that_move_between_samples_are_ahead(arm: Scene) -> None:
    """Half a step ahead of what is held is the mean of a straight line between two commands; none follows the last."""
    np.testing.assert_allclose(response(-0.005, 0.0, 0.01)[0], [0, 0.5, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(response(-0.015, 0.0, 0.01)[0], [0.5, 0.5, 0, 0], atol=1e-12)
    log, between = random_log(arm), Observation.of(arm, 0.01, step=0.002)
    u = between.states(log, between.vector({"ahead.command": 0.005})).u
    last = np.flatnonzero(np.r_[np.diff(log.episode) != 0, True])
    np.testing.assert_allclose(u[last], log.u[last], atol=1e-12)
    rest = np.setdiff1d(np.arange(len(log)), last)
    np.testing.assert_allclose(u[rest], 0.5 * (log.u[rest] + log.u[rest + 1]), atol=1e-12)
    finer = Observation.of(arm, 0.004, step=0.002)
    assert finer.vector({"ahead.command": 0.01})[-3] == pytest.approx(0.003)  # samples are nearer to each other
    own = Observation.of(arm, 0.002)
    assert "ahead" not in {p.group for p in own.parameters}
    assert not own.vector({"ahead.command": 0.01}).any()


@pytest.mark.parametrize(("delay", "lag", "same"), [(-0.004, 0.02, (0.0, 0.016)), (-0.02, 0.008, (-0.012, 0.0))])
def test_a_delay_below_0_makes_the_lag_shorter_first(delay: float, lag: float, same: tuple[float, float]) -> None:
    np.testing.assert_allclose(late_response(delay, lag, 0.01)[0], response(*same, 0.01)[0], atol=1e-12)


def test_a_servo_that_leads_adds_the_rate_of_its_target(arm: Scene) -> None:
    """From one row to the next, and none at the first one; a motor has no target."""
    log, between = random_log(arm), Observation.of(arm, 0.01)
    name = next(p.name for p in between.parameters if p.group == "lead")
    u = between.states(log, between.vector({name: 0.03})).u
    first = np.flatnonzero(np.r_[True, np.diff(log.episode) != 0])
    rest = np.setdiff1d(np.arange(len(log)), first)
    np.testing.assert_allclose(u[first], log.u[first], atol=1e-12)
    np.testing.assert_allclose(u[rest, 0], log.u[rest, 0] + 3.0 * (log.u[rest, 0] - log.u[rest - 1, 0]), atol=1e-12)
    np.testing.assert_allclose(u[:, 1], log.u[:, 1], atol=1e-12)


def test_some_rows_are_those_of_the_whole_log(arm: Scene) -> None:
    log, between = random_log(arm), Observation.of(arm, 0.01)
    psi = np.array([0.03, -0.02, 0.01, 0.2, -0.04, 0.02, 0.005, 0.7, 0.1, 0.013, 0.02])
    rows = np.array([0, 1, 7, 20, 21, 38, 59])
    whole, slope = between.controls(log, psi)
    some, their = between.controls(log, psi, rows)
    np.testing.assert_array_equal(some, whole[rows])
    np.testing.assert_array_equal(their, slope[rows])
    seen = between.states(log, psi, rows)
    for name, told in between.states(log, psi).select(rows).fields().items():
        np.testing.assert_array_equal(seen.fields()[name], told)


def test_a_model_names_what_it_observes(arm: Scene) -> None:
    model = ComplementarityModel(arm, time_step=0.01, observation={"lag.command": 0.02})
    assert model.with_parameters(model.parameters).to_config()["observation"] == {"lag.command": 0.02}
    with pytest.raises(UserError, match=r"did you mean 'lag\.command'"):
        ComplementarityModel(arm, observation={"lag.comand": 0.02})
