"""Logs with sensor noise: free starts, the estimate of the noise, and the horizon that the log asks for."""

from dataclasses import replace

import numpy as np
import pytest

import cmbrl
from cmbrl.data.transitions import Transitions
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.noise import sensor_noise
from cmbrl.fitting.outcome.verdict import advice
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.starts import StartEquations

from .pushed_box import PUSHER, pushes
from .test_fit_hidden import scene

SIGMA = np.array([2e-3, 2e-3, 2e-2, 2e-2])  # of q and v of two carts


def _measured(log: Transitions, seed: int = 5) -> Transitions:
    """``log`` through sensors: a state has the same error where a transition ends and where the next one starts."""
    draw = np.random.default_rng(seed)
    q, v, q_next, v_next = [], [], [], []
    for episode in np.unique(log.episode):
        rows = log.episode == episode
        noise = draw.normal(size=(rows.sum() + 1, 4)) * SIGMA
        q.append(log.q[rows] + noise[:-1, :2])
        v.append(log.v[rows] + noise[:-1, 2:])
        q_next.append(log.q_next[rows] + noise[1:, :2])
        v_next.append(log.v_next[rows] + noise[1:, 2:])
    parts = {name: np.concatenate(x) for name, x in (("q", q), ("v", v), ("q_next", q_next), ("v_next", v_next))}
    return Transitions(**parts, u=log.u, dt=log.dt, episode=log.episode)


@pytest.fixture
def noisy(carts):
    return _measured(carts.record(carts.truth(2, gear_1=0.7, damping_0=2.0), episodes=20, steps=40))


@pytest.fixture(params=[1, 4])
def setup(carts, noisy, request):
    evidence = Evidence.of(carts.model(2), noisy)
    starts, steps = draw_starts(noisy, request.param, 300, 0), request.param
    return evidence.space, evidence.loss(starts, steps, *evidence.scales(steps, 0.3, SIGMA[None]))


def test_noise_of_both_kinds_is_found_with_the_right_model(carts, noisy):
    evidence = Evidence.of(carts.truth(2, gear_1=0.7, damping_0=2.0), noisy)
    np.testing.assert_allclose(sensor_noise(evidence, evidence.space.nominal), [SIGMA], rtol=0.2)


def test_a_clean_log_has_no_noise_even_if_the_model_is_wrong(carts):
    log = carts.record(carts.truth(2, gear_1=0.5, damping_0=3.0, tilt=0.5), episodes=20, steps=40)
    evidence = Evidence.of(carts.model(2), log)
    assert sensor_noise(evidence, evidence.space.nominal) is None


def test_late_commands_are_no_noise(carts):
    """A robot that acts one row late leaves differences of commands, which alternate as noise does."""
    log = carts.record(carts.truth(2, gear_1=0.7, damping_0=2.0), episodes=20, steps=40)
    draw = np.random.default_rng(3)
    late = replace(log, u=draw.uniform(-1.0, 1.0, log.u.shape))
    acted = np.roll(late.u, 1, axis=0)
    step = carts.truth(2, gear_1=0.7, damping_0=2.0)
    q, v = log.q[0], log.v[0]
    states = []
    for u in acted:
        found = step.predict(q[None], v[None], u[None])
        states.append((q, v, found.q_next[0], found.v_next[0]))
        q, v = states[-1][2:]
    q, v, q_next, v_next = (np.array(x) for x in zip(*states, strict=True))
    late = replace(late, q=q, v=v, q_next=q_next, v_next=v_next, episode=np.zeros(len(q), dtype=int))
    evidence = Evidence.of(step, late)
    assert sensor_noise(evidence, evidence.space.nominal) is None


def test_noise_that_a_controller_answers_to_is_noise(tmp_path):
    """Its torque brakes the measured speed, and so the command after a row goes with the error at the row's end."""
    (tmp_path / "wheel.xml").write_text(
        '<mujoco><option timestep=".002"/><worldbody><body><joint name="j" damping=".1" armature=".05"/>'
        '<geom size=".1"/></body></worldbody><actuator><motor name="j" joint="j"/></actuator></mujoco>'
    )
    model, draw = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "wheel.xml")), np.random.default_rng(0)
    q, v, states, commands = np.zeros((1, 1)), np.zeros((1, 1)), [], []
    for k in range(2000):
        seen = v + 0.02 * draw.normal()
        states.append((q[0], seen[0]))
        commands.append([5.0 * (np.sin(0.005 * k) - q[0, 0]) - 2.0 * seen[0, 0]])
        step = model.predict(q, v, np.array(commands[-1:]))
        q, v = step.q_next, step.v_next
    places, speeds = (np.array(x) for x in zip(*states, strict=True))
    log = Transitions(
        q=places[:-1], v=speeds[:-1], u=np.array(commands[:-1]), q_next=places[1:], v_next=speeds[1:], dt=0.002,
        episode=np.zeros(1999, dtype=int),
    )  # fmt: skip
    evidence = Evidence.of(model, log)
    assert sensor_noise(evidence, evidence.space.nominal)[0, 1] == pytest.approx(0.02, rel=0.2)


def test_noise_of_positions_shows_without_the_right_model(tmp_path):
    """Contacts hide it from the model: a box that lies on a table forgets where it was."""
    model = cmbrl.ComplementarityModel(scene(tmp_path, PUSHER.format(floor=0.6, mass=0.4)))
    clean, noisy = (Evidence.of(model, pushes(12, 60, noise)) for noise in (0.0, 1e-4))
    expected = np.array([1e-4] * 5 + [1e-3] * 3)
    nominal = noisy.space.nominal
    np.testing.assert_allclose(sensor_noise(noisy, nominal)[0, :8], expected, rtol=0.4)
    told = sensor_noise(clean, nominal)
    assert told is None or not told[0, :8].any()


def test_without_noise_the_starts_are_the_logged_states(carts, noisy):
    evidence = Evidence.of(carts.model(2), noisy)
    loss = evidence.loss(noisy.windows(3), 3, *evidence.scales(3, 0.3))
    assert loss.settled(evidence.space.nominal) is loss


def test_noise_that_vanishes_is_the_limit_of_none(carts, noisy):
    evidence = Evidence.of(carts.model(2), noisy)
    values = []
    for noise in (None, 1e-6 * SIGMA[None]):
        loss = evidence.loss(noisy.windows(3), 3, *evidence.scales(3, 0.3, noise))
        values.append(loss.errors(evidence.space.nominal).mean)
    assert values[1] == pytest.approx(values[0], rel=1e-6)


def test_settled_starts_are_the_best_ones(setup):
    space, loss = setup
    moved = 0.1 * ~space.columns(["motor_zero", "lag"])  # which push carts far off: starts settle to 1e-8 then
    theta = space.theta(moved)
    settled = loss.settled(theta)
    best = settled.values(theta[None])[0]
    assert best < loss.values(theta[None])[0]
    draw = np.random.default_rng(0)
    for _ in range(5):
        offset = settled.windows.offset + 1e-3 * SIGMA * draw.normal(size=settled.windows.offset.shape)
        assert loss.starting(offset).values(theta[None])[0] > best - 1e-9
    np.testing.assert_allclose(loss.errors(theta).mean, best, rtol=1e-9)


def test_gradient_of_the_loss_with_free_starts_equals_finite_differences(setup):
    """The starts settle anew for each z, so this is the derivative of a minimum."""
    space, loss = setup
    z = 0.05 + 0.1 * np.random.default_rng(1).normal(size=len(space)) ** 2
    step = 1e-4 * np.eye(len(space))

    def value(point: np.ndarray) -> float:
        theta = space.theta(point)
        return loss.settled(theta).settled(theta).values(theta[None])[0]

    numeric = [(value(z + s) - value(z - s)) / 2e-4 for s in step]
    settled = loss.settled(space.theta(z)).settled(space.theta(z))
    np.testing.assert_allclose(settled.normal_equations(space, z).gradient, numeric, rtol=5e-3, atol=1e-5)


def test_starts_follow_the_parameters(setup):
    """The starts after a step are those that settle there, but for curvature that Gauss-Newton leaves out."""
    space, loss = setup
    smooth = replace(loss.windows.scales, huber=50.0)
    loss = replace(loss, windows=replace(loss.windows, scales=smooth))
    z, active = np.zeros(len(space)), np.ones(len(space), dtype=bool)
    objective = Objective.at(loss.settled(space.theta(z)), space, active, z)
    equations = objective.normal_equations(z)
    step = 1e-3 * np.random.default_rng(2).normal(size=len(space))
    step[-2:] = np.abs(step[-2:])  # delay and lag
    followed = objective.followed(equations, step[None])[0]
    settled = objective.loss.settled(space.theta(z + step)).windows.offset
    moved = np.abs(settled - objective.loss.windows.offset).max()
    assert np.abs(followed - settled).max() < 0.3 * moved


def test_a_noisy_log_is_fitted_without_bias(carts, noisy):
    """Random actions and much noise: one step alone says little, and what it says is wrong."""
    model = carts.model(2)
    result = cmbrl.fit(model, noisy, groups=["gear", "damping"], method="gauss-newton")
    assert result.report["horizon"] > 1
    np.testing.assert_allclose(result.report["noise"], [SIGMA], rtol=0.25)
    assert result.parameters["gear.1"].value == pytest.approx(0.7, rel=0.04)
    assert result.parameters["damping.0"].value == pytest.approx(2.0, rel=0.1)
    assert "sensor noise of positions" in result.report_text()


def test_advice_names_a_setting_that_is_clearly_better():
    assert advice([{"setting": "integrator midpoint", "relative_error": 0.95}]) is None
    better = [{"setting": "integrator midpoint", "relative_error": 0.3}]
    assert "integrator midpoint left 0.30" in advice(better)
    assert "integrator midpoint left 0.30" in advice(better, {"taken": False})
    assert advice(better, {"taken": True}) is None  # another law did more, with parameters that moved


def test_a_window_that_blows_up_does_not_end_the_fit() -> None:
    """Its slopes are so large that one direction is all that is left of them; other windows are as without it."""
    blown, sound = np.full((2, 2), 1e22), np.array([[2.0, 0.5], [0.5, 1.0]])
    assert np.linalg.det(blown) == 0
    right = np.array([[[1e11], [1e11]], [[1.0], [2.0]]])
    found = StartEquations(right[..., 0], np.array([blown, sound])).solve(right)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(blown @ found[0], right[0], rtol=1e-8)
    np.testing.assert_allclose(found[1], np.linalg.solve(sound, right[1]), rtol=0, atol=1e-8)
