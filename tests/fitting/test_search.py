"""The three searches on a cart whose truth is known, and the candidates of the random one."""

import numpy as np
import pytest

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.cma import cma_search
from cmbrl.fitting.search.gauss_newton import gauss_newton, reweighed
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.random_search import propose, random_search
from cmbrl.fitting.state import Journal
from cmbrl.models.windows import Scales

TRUTH = {"damping_0": 2.2, "gear_0": 0.6, "tilt": 0.5}


def _objective(carts, truth=TRUTH, active=("damping", "gear", "tilt")):
    data = carts.record(carts.truth(1, **truth), episodes=4, steps=40)
    model = carts.model()
    evidence = Evidence.of(model, data)
    space = evidence.space
    loss = evidence.loss(data.windows(1), 1, Scales.of(model.scene, data, 1.0))
    return Objective(loss, space, space.columns(active), strength=1e-9)


@pytest.mark.parametrize(("search", "tolerance"), [(random_search, 0.05), (cma_search, 0.01)])
def test_search_comes_near_the_truth(carts, search, tolerance):
    objective = _objective(carts)
    found = search(objective, np.zeros(len(objective.space)), 0, 40, 32, Journal(None, ""), "test")
    theta = dict(zip(objective.space.names, objective.space.theta(found.z), strict=True))
    assert theta["damping.0"] == pytest.approx(2.2, rel=tolerance)
    assert theta["gear.0"] == pytest.approx(0.6, rel=tolerance)
    assert theta["mass.0"] == 1.0
    assert found.candidates == 40 * 32


def test_cma_takes_a_single_parameter(carts):
    objective = _objective(carts, {"tilt": 0.5}, ("tilt",))
    found = cma_search(objective, np.zeros(len(objective.space)), 0, 15, 8, Journal(None, ""), "test")
    assert objective.space.theta(found.z)[4] == pytest.approx(0.5, abs=0.01)


def test_gauss_newton_reaches_the_truth(carts):
    objective = _objective(carts)
    found = gauss_newton(objective, np.zeros(len(objective.space)), 20, Journal(None, ""))
    np.testing.assert_allclose(objective.space.theta(found.z)[[1, 3, 4]], [2.2, 0.6, 0.5], rtol=1e-4)


@pytest.mark.parametrize("heavy", [0.0, 1e4])
def test_passes_explain_what_one_pass_holds_back(carts, heavy):
    """The errors of the file make its prior hold parameters that a log without noise tells exactly."""
    objective = _objective(carts)
    loss, space, active, start = objective.loss, objective.space, objective.active, np.zeros(len(objective.space))
    once, often = (
        reweighed(loss, space, active, start, 8, Journal(None, ""), heavy, passes=passes) for passes in (1, 12)
    )
    left = loss.values(space.theta(np.stack([once, often])))
    assert left[1] < 1e-6 * left[0]
    np.testing.assert_allclose(space.theta(often)[[1, 3, 4]], [2.2, 0.6, 0.5], rtol=1e-4)


def test_gauss_newton_stops_at_a_bound_and_fits_the_rest(carts):
    objective = _objective(carts, {"tilt": -3.0, "gear_0": 0.6}, ("gear", "tilt"))  # tilt is bounded by -2
    found = gauss_newton(objective, np.zeros(len(objective.space)), 30, Journal(None, ""))
    theta = objective.space.theta(found.z)
    assert theta[4] == -2.0
    assert np.flatnonzero(objective.space.at_bound(found.z)).tolist() == [4]
    assert abs(objective.normal_equations(found.z).gradient[3]) < 1e-3  # the rest is at its optimum given the bound


class Chaotic(Objective):
    """Far from its start, motion is another one."""

    def values(self, z, offset=None, most=np.inf):
        return super().values(z, offset) + 1e3 * (np.abs(z).max(axis=1) > 1e-3)


def test_one_iteration_leaves_its_start_where_only_short_steps_help(carts):
    plain = _objective(carts)
    objective = Chaotic(plain.loss, plain.space, plain.active, plain.strength)
    start = np.zeros(len(objective.space))
    found = gauss_newton(objective, start, 1, Journal(None, ""))
    assert 0.0 < np.abs(found.z).max() <= 1e-3
    assert found.value < objective.values(start[None])[0]


def test_candidate_depends_on_seed_round_and_index_only(carts):
    objective = _objective(carts)
    moving = np.flatnonzero(objective.active)
    few, many = (propose(objective, np.zeros(len(objective.space)), moving, np.ones(3), 5, "a", 2, n) for n in (10, 50))
    assert np.array_equal(few, many[:10])
    other = propose(objective, np.zeros(len(objective.space)), moving, np.ones(3), 6, "a", 2, 10)
    assert not np.array_equal(few, other)
    assert (many[:, ~objective.active] == 0.0).all()
    assert (many <= objective.space.z_high).all()
    assert (many >= objective.space.z_low).all()
