"""The loss and its Gauss-Newton model agree with each other and with finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.objective import Objective
from cmbrl.models.deviations import REST
from cmbrl.models.windows import Scales


@pytest.fixture(params=[1, 3])
def setup(carts, request):
    data = carts.record(carts.truth(2, damping_0=2.0, gear_1=0.5, tilt=0.5), episodes=5, steps=20)
    model = carts.model(2)
    evidence = Evidence.of(model, data)
    space = evidence.space
    scales = Scales.of(model.scene, data, huber=0.3)  # many residuals beyond it
    loss = evidence.loss(data.windows(request.param), request.param, scales)
    return space, loss


def test_native_batch_equals_errors_start_by_start(setup):
    space, loss = setup
    theta = space.theta(0.2 * np.random.default_rng(1).normal(size=(4, len(space))))
    np.testing.assert_allclose(loss.values(theta), [loss.errors(t).mean for t in theta], rtol=1e-12)


def test_windows_that_cover_a_part_of_a_log_see_what_all_of_it_tells(setup):
    space, loss = setup
    z = 0.2 * np.random.default_rng(1).normal(size=len(space))
    z = np.where(space.nominal == space.low, np.abs(z), z)  # delay, lag, dead zones
    theta = space.theta(z)
    psi = loss.observation.split(theta)[1]
    assert loss.observation.changes(psi)
    sparse = loss.on(loss.windows.starts[3::7])
    assert len(sparse.windows.rows) < 0.7 * len(loss.windows.data)
    known = replace(sparse.windows, data=loss.observation.states(loss.windows.data, psi))
    as_told = np.append(theta[: len(theta) - len(loss.observation)], loss.observation.nominal)
    np.testing.assert_allclose(sparse.values(theta[None]), replace(sparse, windows=known).values(as_told[None]))
    equations = sparse.normal_equations(space, z)
    step = 1e-5 * np.eye(len(space))
    numeric = (sparse.values(space.theta(z + step)) - sparse.values(space.theta(z - step))) / 2e-5
    np.testing.assert_allclose(equations.gradient, numeric, rtol=1e-4, atol=1e-7)


def test_gradient_equals_finite_differences(setup):
    space, loss = setup
    objective = Objective(loss, space, np.ones(len(space), dtype=bool), strength=0.01)
    z = 0.1 + 0.2 * np.random.default_rng(1).normal(size=len(space)) ** 2
    step = 1e-5 * np.eye(len(space))
    numeric = (objective.values(z + step) - objective.values(z - step)) / 2e-5
    equations = objective.normal_equations(z)
    np.testing.assert_allclose(equations.gradient, numeric, rtol=1e-4, atol=1e-7)
    by_episode = equations.episode_gradients.sum(axis=0) + objective.strength * (space.precision @ z)
    np.testing.assert_allclose(by_episode, equations.gradient, atol=1e-12)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_gradient_of_the_tolerant_loss_equals_finite_differences(carts, noise):
    data = carts.record(carts.truth(2, damping_0=2.0, gear_1=0.5, tilt=0.5), episodes=5, steps=20)
    evidence = Evidence.of(carts.model(2), data)
    space, n = evidence.space, len(evidence.space)
    of_sensors = None if noise == 0.0 else np.full((1, 2 * evidence.model.scene.nv), noise)
    loss = evidence.loss(data.windows(2), 2, *evidence.scales(2, 0.3, of_sensors))
    z = 0.1 + 0.2 * np.random.default_rng(1).normal(size=n) ** 2
    loss = loss.tolerant(space.theta(z), 0.5)
    assert (loss.windows.offset is None) is (noise == 0.0)
    equations = loss.normal_equations(space, z)
    step = 1e-5 * np.eye(n)

    def settled(z):  # the best starts move with the parameters, and their first-order effect is none
        return np.array([loss.settled(theta).values(theta[None])[0] for theta in space.theta(z)])

    numeric = (settled(z + step) - settled(z - step)) / 2e-5
    np.testing.assert_allclose(equations.gradient, numeric, rtol=1e-3, atol=1e-6)
    assert np.linalg.eigvalsh(equations.hessian).min() > -1e-12


def test_windows_far_off_count_by_their_logarithm(setup):
    space, loss = setup
    theta = space.theta(0.1 * np.ones(len(space)))
    own, plain = loss.tolerant(theta, 0.5), loss.errors(theta).loss
    level = np.median(plain)
    assert own.windows.level == pytest.approx(level)
    np.testing.assert_allclose(own.errors(theta).loss, level * np.log1p(plain / level))
    assert own.tolerant(theta, 0.5).windows.level == pytest.approx(level)  # of the plain loss again


def test_equations_over_some_columns_are_those_of_all_with_zeros(setup):
    space, loss = setup
    z = 0.1 * np.ones(len(space))
    active = space.columns(["gear", "tilt"])
    whole, part = loss.normal_equations(space, z), loss.normal_equations(space, z, active)
    np.testing.assert_allclose(part.gradient, np.where(active, whole.gradient, 0.0), rtol=1e-12)
    np.testing.assert_allclose(part.hessian, np.where(np.outer(active, active), whole.hessian, 0.0), rtol=1e-12)
    np.testing.assert_allclose(part.episode_gradients, np.where(active, whole.episode_gradients, 0.0), rtol=1e-12)
    assert (part.independent, part.variance) == (whole.independent, whole.variance)


def test_every_parameter_but_the_idle_one_changes_the_loss(setup):
    space, loss = setup
    nominal = loss.values(space.nominal[None])[0]
    moved = loss.values(space.theta(0.1 * np.eye(len(space))))
    assert [n for n, value in zip(space.names, moved, strict=True) if value == nominal] == ["bumper"]


def test_a_coordinate_that_never_moves_does_not_rule(carts):
    data = carts.record(carts.model(2), episodes=2, steps=20)
    still = data.v_next.copy()
    still[:, 1] = data.v[:, 1]
    object.__setattr__(data, "v_next", still)
    scales = Scales.of(carts.model(2).scene, data, 1.0)
    assert scales.v[1] == pytest.approx(max(1e-3 * scales.v[0], REST))


def test_what_rests_is_measured_against_what_rests(carts):
    """A cart that only rounding moves: in the unit of that motion a fit would be of nothing else."""
    data = carts.record(carts.model(2), episodes=2, steps=20)
    rest = 1e-7 * np.random.default_rng(0).normal(size=len(data))
    for name in ("v", "v_next"):
        object.__setattr__(data, name, getattr(data, name) * [1.0, 0.0] + np.outer(rest, [0.0, 1.0]))
    for name in ("q", "q_next"):
        object.__setattr__(data, name, getattr(data, name) * [1.0, 0.0])
    scene = carts.model(2).scene
    scales = Scales.of(scene, data, 1.0)
    assert scales.v[1] >= REST
    assert scales.q[1] >= REST * data.dt
    assert scales.v[0] == pytest.approx((data.v_next - data.v)[:, 0].std())
