"""Fits under a time limit, on a clock that runs with the rows that a model predicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import cmbrl
from cmbrl.fitting import Budget
from cmbrl.fitting import clock as clock_module
from cmbrl.fitting import pace as pace_module
from cmbrl.fitting import state as state_module
from cmbrl.fitting.pace import ALLOWED, PARTS

CANDIDATES = 8  # rows of derivatives take as long as so many of a prediction
Slow = Callable[[float], Any]


@pytest.fixture
def data(two_carts):
    return two_carts


@pytest.fixture
def clock(monkeypatch) -> SimpleNamespace:
    """Seconds of the processor, ``now``, that pass in models only; ``wall``: how many pass on the wall meanwhile."""
    told = SimpleNamespace(now=0.0, wall=1.0)
    times = SimpleNamespace(monotonic=lambda: told.wall * told.now, process_time=lambda: told.now)
    for module in (state_module, clock_module):
        monkeypatch.setattr(module, "time", times)
    return told


@pytest.fixture
def slow(carts, clock) -> Slow:
    """``slow(seconds)``: a model that takes so long for a row."""

    def made(seconds: float) -> Any:
        model = carts.model(2)
        predict, losses = model.predict, model.candidate_losses

        def slow_predict(q, v, u, theta=None, jacobian=False, parameter_jacobian=None):
            clock.now += seconds * len(q) * (CANDIDATES if jacobian else 1)
            return predict(q, v, u, theta, jacobian, parameter_jacobian)

        def slow_losses(theta, windows):  # predicts by the slow one
            return losses(theta, windows)

        model.predict, model.candidate_losses = slow_predict, slow_losses
        return model

    return made


def values(result: Any) -> dict[str, float]:
    return {name: p.value for name, p in result.parameters.items()}


def test_a_limit_that_is_long_enough_changes_nothing(data, whole_fit, slow, clock, tmp_path: Path) -> None:
    result = cmbrl.fit(slow(1e-3), data, time_limit=1e5, folder=tmp_path)
    assert values(result) == values(whole_fit)
    assert (result.report["pace"], result.report["stopped"]) == (None, None)
    without = {k: v for k, v in whole_fit.report.items() if k not in ("seconds", "resumed")}
    assert {k: result.report[k] for k in without} == without
    before = clock.now
    again = cmbrl.fit(slow(1e-3), data, time_limit=1e5, folder=tmp_path)
    assert values(again) == values(whole_fit)
    assert clock.now - before < 0.5 * before  # from the journal, but for errors and intervals


@pytest.mark.parametrize("seconds", [3e-4, 1e-3, 4e-3, 7e-3])
def test_a_slow_model_is_fitted_in_time(data, slow, clock, seconds: float) -> None:
    """To the end, and better than the file; without a limit it would take up to 30 times as long."""
    limit = 200.0
    result = cmbrl.fit(slow(seconds), data, time_limit=limit)
    assert clock.now < 1.25 * limit
    assert result.report["pace"]["limit"] == limit
    assert set(result.report["pace"]["shares"]) <= set(PARTS)
    loss = result.report["loss"]
    assert loss["held out, fitted"]["rmse"] < 0.5 * loss["held out, nominal"]["rmse"]
    assert result.report["horizons"]
    assert "for the limit of 200 s, parts did less" in " ".join(result.report_text().split())


@pytest.mark.parametrize("wall", [1.0, 3.0])
def test_without_a_limit_a_fit_has_some_seconds_of_the_processor(data, slow, clock, wall: float) -> None:
    """However many pass on the wall meanwhile."""
    clock.wall = wall
    result = cmbrl.fit(slow(4e-3), data)
    assert 100.0 < clock.now < 1.25 * ALLOWED
    assert result.report["pace"]["limit"] == ALLOWED
    loss = result.report["loss"]
    assert loss["held out, fitted"]["rmse"] < 0.5 * loss["held out, nominal"]["rmse"]
    assert "give more by --time-limit" in " ".join(result.report_text().split())


def test_what_was_done_in_a_hurry_is_done_again_without_a_limit(carts, data, whole_fit, slow, tmp_path: Path) -> None:
    hurried = cmbrl.fit(slow(4e-3), data, time_limit=200.0, folder=tmp_path)
    assert values(hurried) != values(whole_fit)
    resumed = cmbrl.fit(carts.model(2), data, folder=tmp_path)
    assert resumed.report["resumed"]
    assert values(resumed) == values(whole_fit)


def test_parts_that_overrun_leave_time_for_the_others(data, slow, clock, monkeypatch) -> None:
    """Where the first rows were four times as fast as all others."""
    timed = pace_module.Speed.of
    quick = lambda *a: replace(s := timed(*a), **{k: x / 4 for k, x in vars(s).items() if k != "together"})  # noqa: E731
    monkeypatch.setattr(pace_module.Speed, "of", quick)
    result = cmbrl.fit(slow(4e-3), data, time_limit=200.0)
    assert clock.now < 1.25 * 200.0
    loss = result.report["loss"]
    assert loss["held out, fitted"]["rmse"] < 0.5 * loss["held out, nominal"]["rmse"]


def test_rows_that_are_slow_at_first_cost_a_fit_nothing(data, whole_fit, slow, clock, monkeypatch) -> None:
    """The first pass of a model waits for its memory, and other processes make some later ones slow too."""
    once, passes = pace_module.Speed._once, []

    def disturbed(*arguments: Any) -> Any:
        passes.append(once(*arguments))
        return passes[-1] * (1.0 if len(passes) % pace_module._PASSES == 0 else 20.0)

    monkeypatch.setattr(pace_module.Speed, "_once", staticmethod(disturbed))
    result = cmbrl.fit(slow(2e-5), data)
    assert len(passes) > pace_module._PASSES
    assert values(result) == values(whole_fit)
    assert (result.report["pace"], result.report["stopped"]) == (None, None)


def test_a_shrunk_budget() -> None:
    budget = Budget()
    assert budget.shrunk(1.0) == budget
    shares = [budget.shrunk(share) for share in (0.5, 0.1, 0.01)]
    rows = [b.polish_rows for b in (budget, *shares)]
    assert rows == sorted(rows, reverse=True)
    few = Budget(survey_rows=30, starts=1)
    assert few.shrunk(0.01).survey_rows == 30
    assert few.shrunk(0.01).starts == 1


def test_choices_by_a_noisy_log_do_less_and_what_follows_does_not() -> None:
    usual, noisy = Budget.of(18), Budget.of(18, noisy=True)
    less = {name for name, most in asdict(usual).items() if asdict(noisy)[name] < most}
    assert {"survey_rows", "trial_rows", "search_rows", "starts"} <= less
    assert not less & {"polish_rows", "polish_iterations", "fold_iterations", "folds", "judged", "draws"}
