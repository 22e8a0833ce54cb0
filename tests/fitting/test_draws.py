"""Draws of a fit: with its covariance, as far as the log bears them."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.outcome.draws import LOST, WORSE, around, bearable


def test_draws_have_the_covariance() -> None:
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    drawn = around(np.array([1.0, 2.0, 3.0]), np.array([0, 2]), covariance, 200_000, 0)
    np.testing.assert_allclose(drawn.mean(axis=0), [1.0, 2.0, 3.0], atol=5e-3)
    assert (drawn[:, 1] == 2.0).all()
    np.testing.assert_allclose(np.cov(drawn[:, [0, 2]].T), covariance, atol=2e-3)


def test_a_delay_is_not_negative_and_what_goes_with_it_keeps_its_spread() -> None:
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    drawn = around(np.array([1.0, 0.0]), np.array([0, 1]), covariance, 200_000, 0, delay=1)
    assert drawn[:, 1].min() >= 0.0
    np.testing.assert_allclose((drawn[:, 1] ** 2).mean(), 0.09, rtol=0.02)
    np.testing.assert_allclose(((drawn[:, 0] - 1.0) ** 2).mean(), 0.04, rtol=0.02)
    np.testing.assert_allclose(((drawn[:, 0] - 1.0) * drawn[:, 1]).mean(), 0.03, rtol=0.03)


@pytest.fixture
def fitted(carts):
    """The loss of a kicked cart that has a third more gear than its file, its space, and the truth in z."""
    truth = carts.truth(1, gear_0=1.3)
    log = carts.record(truth, episodes=4, steps=30, noise=0.002)
    evidence = Evidence.of(carts.model(1), log)
    loss = evidence.loss(log.windows(1), 1, *evidence.scales(1, 0.5))
    space = evidence.space
    return loss, space, space.z(np.append(truth.parameters, space.nominal[len(truth.parameters) :]))


def covariance_of(space, deviation: float) -> np.ndarray:
    """Of the gear alone, in z."""
    return np.diag(np.where([name == "gear.0" for name in space.names], deviation**2, 0.0))


@pytest.mark.parametrize("deviation", [1.0, 3.0])
def test_half_of_the_draws_explain_the_log_about_as_well(fitted, deviation) -> None:
    loss, space, z = fitted
    share = bearable(loss, space, z, covariance_of(space, deviation))
    assert 0 < share < 1
    at, file = loss.values(np.stack([space.theta(z), space.nominal]))
    most = at + max(WORSE * at, LOST * (file - at))
    places, sizes = np.array([space.names.index("gear.0")]), {share: True, 2 * share: False}
    for size, bears in sizes.items():
        drawn = around(z, places, np.array([[(size * deviation) ** 2]]), 400, 7)
        assert bool(np.mean(loss.values(space.theta(drawn)) <= most) > 0.4) == bears


def test_what_the_log_bears_is_drawn_as_it_is(fitted) -> None:
    loss, space, z = fitted
    assert bearable(loss, space, z, covariance_of(space, 1e-4)) == 1.0
    assert bearable(loss, space, z, covariance_of(space, 0.0)) == 1.0
