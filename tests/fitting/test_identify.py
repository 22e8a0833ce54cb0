"""Intervals cover the truth; what the data cannot tell is named."""

import numpy as np

from cmbrl.fitting.evidence import Evidence
from cmbrl.fitting.gauss_newton import gauss_newton
from cmbrl.fitting.identify import _flat_directions, identify
from cmbrl.fitting.objective import Objective
from cmbrl.fitting.state import Journal
from cmbrl.models.windows import Scales


def _identify(carts, data, columns):
    model = carts.model()
    evidence = Evidence.of(model, data)
    space = evidence.space
    loss = evidence.loss(data.windows(1), 1, Scales.of(model.scene, data, 5.0))
    objective = Objective(loss, space, space.columns(columns), strength=1e-6)
    found = gauss_newton(objective, np.zeros(len(objective.space)), 20, Journal(None, ""))
    return space, identify(space, found.z, objective.active, loss.normal_equations(space, found.z))


def test_intervals_cover_the_truth_as_often_as_they_say(carts):
    covered = []
    for seed in range(60):
        data = carts.record(carts.truth(1, damping_0=1.5), 12, 20, seed=seed, noise=0.01)
        _, known = _identify(carts, data, ["damping", "gear"])
        covered += [known.low[1] <= 1.5 <= known.high[1], known.low[3] <= 1.0 <= known.high[3]]
    assert 0.88 <= np.mean(covered) <= 1.0  # 95 % asked, 120 tries: three standard errors are 6 %


def test_the_unit_of_force_is_a_flat_direction(carts):
    data = carts.record(carts.model(), 8, 30, noise=1e-3)
    _, known = _identify(carts, data, ["mass", "damping", "frictionloss", "gear", "bumper"])
    directions = [d["parameters"] for d in known.directions]
    assert {"bumper": 1.0} in directions
    scale = next(d for d in directions if "mass.0" in d)
    assert set(scale) == {"mass.0", "damping.0", "frictionloss.0", "gear.0"}
    assert min(scale.values()) > 0.99  # all by the same factor


def test_parameters_without_any_information_are_not_mixed():
    information = np.zeros((4, 4))
    information[:2, :2] = [[2.0, -2.0], [-2.0, 2.0]]
    found = _flat_directions(information, ["a", "b", "c", "d"])
    assert [d["parameters"] for d in found] == [{"c": 1.0}, {"d": 1.0}, {"a": 1.0, "b": 1.0}]


def test_what_is_not_fitted_is_seen_or_not(carts):
    data = carts.record(carts.model(), 8, 30, noise=1e-3)
    space, known = _identify(carts, data, ["damping"])
    assert [n for k, n in enumerate(space.names) if known.unseen[k]] == ["bumper"]
    assert known.low[0] == known.high[0] == 1.0
    assert known.low[1] < 1.0 < known.high[1]
    assert not known.flat.any()
