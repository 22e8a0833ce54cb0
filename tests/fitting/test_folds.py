"""Rows that are drawn to be held out in turn, where a window is nearly as long as all that may be drawn."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.fitting.search.folds import (
    NOISE_FACTOR,
    Folds,
    draw_starts,
    fold_of_rows,
    paired_gain,
    typical_rise,
    windows_in_blocks,
)
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal
from cmbrl.models.windows import Scales, Windows


def loss_on(carts, data, starts: np.ndarray, horizon: int) -> PredictionLoss:
    model = carts.model(2)
    windows = Windows(data, starts, horizon, Scales.of(model.scene, data, 2.0))
    return PredictionLoss(model, windows, model.observer)


@pytest.mark.parametrize("seed", range(5))
def test_one_window_is_never_all_that_folds_are_made_of(carts, seed: int) -> None:
    data = carts.record(carts.truth(2), episodes=4, steps=40, noise=1e-3)
    alone, starts = draw_starts(data, 40, 40, seed), draw_starts(data, 40, 40, seed, folds=4)
    assert len(alone) == 1
    assert set(alone) < set(starts)
    fold = fold_of_rows(data, 4, seed)[starts]
    assert len(set(fold)) == 2
    loss = loss_on(carts, data, starts, 40)
    assert len(Folds.of(loss, loss, 4, seed).train) == 2


def test_draws_of_several_folds_stay_as_they_are(carts) -> None:
    data = carts.record(carts.truth(2), episodes=4, steps=40, noise=1e-3)
    np.testing.assert_array_equal(draw_starts(data, 5, 100, 0), draw_starts(data, 5, 100, 0, folds=4))


def test_draws_lie_all_over_the_log(carts) -> None:
    data = carts.record(carts.truth(2), episodes=1, steps=400, noise=1e-3)
    possible, drawn = windows_in_blocks(data, 10), draw_starts(data, 10, 200, 0)
    assert len(drawn) == 20
    stretch = np.searchsorted(possible, drawn) * len(drawn) // len(possible)
    np.testing.assert_array_equal(stretch, np.arange(20))


def test_a_fit_without_a_fold_weighs_the_prior_as_it_is_told(carts) -> None:
    data = carts.record(carts.truth(2), episodes=4, steps=40, noise=1e-3)
    loss = loss_on(carts, data, draw_starts(data, 5, 400, 0), 5)
    model, late = loss.model, loss.observation
    space = Space.of((*model.scene.parameters, *late.parameters), np.append(model.parameters, late.nominal))
    active, z = space.columns(["mass"]), np.zeros(len(space))
    folds = Folds.of(loss, loss, 4, 0)
    free, held = (folds.refit(space, active, z, 5, Journal(None, ""), least)[0][0] for least in (0.0, 1e3))
    assert np.abs(held).max() < 0.5 * np.abs(free).max()
    assert Objective.at(loss, space, active, z, 1e3).variance == 1e3


def test_a_log_with_one_long_episode_says_that_nothing_can_be_held_out(carts) -> None:
    data = carts.record(carts.truth(2), episodes=4, steps=40, noise=1e-3)
    starts = draw_starts(data, 40, 40, 0)
    loss = loss_on(carts, data, starts, 40)
    with pytest.raises(UserError, match=r"only one episode has 40 consecutive transitions.*leave out the short ones"):
        Folds.of(loss, loss, 4, 0)


def test_one_block_that_nothing_predicts_does_not_hide_what_the_others_say() -> None:
    """Mean losses of eight blocks with and without a delay that is there; the last holds what no other block has."""
    blocks = np.repeat(np.arange(8), 10)
    kept = np.repeat([0.8e-4, 0.9e-4, 1.7e-4, 0.7e-4, 0.6e-4, 0.6e-4, 0.7e-4, 40e-4], 10)
    without = np.repeat([1.4e-4, 2.7e-4, 8.9e-4, 5.9e-4, 1.1e-4, 1.1e-4, 2.9e-4, 35e-4], 10)
    rise, noise = paired_gain(without, kept, blocks)
    assert rise < NOISE_FACTOR * noise  # the mean does not tell
    typical, error = typical_rise(kept, without, blocks)
    assert typical > NOISE_FACTOR * error
    assert typical_rise(kept, kept, blocks) == (0.0, 0.0)
    assert typical_rise(kept[:10], without[:10], blocks[:10])[1] == np.inf


def test_starts_that_nothing_predicts_do_not_speak_for_their_blocks() -> None:
    """Eight blocks with and without a delay that is there; in every other one a foot slips, by chance."""
    blocks = np.repeat(np.arange(8), 6)
    kept = np.full(48, 4e-3)
    without = 1.2 * kept
    kept[5::12], without[5::12] = 0.09, [0.06, 0.11, 0.07, 0.08]
    rise, noise = paired_gain(without, kept, blocks)
    assert rise < NOISE_FACTOR * noise  # the mean does not tell
    typical, error = typical_rise(kept, without, blocks)
    assert typical > 2 * NOISE_FACTOR * error


def test_what_the_solver_leaves_is_no_rise() -> None:
    blocks, still = np.arange(8), np.full(8, 1e-14)
    assert typical_rise(still, 100.0 * still, blocks)[0] < 1e-3
