"""What is said of laws that a fit took though the log tells none of their values from 0."""

from __future__ import annotations

import pytest

from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.outcome.laws_told import doubtful_laws, laws_told, play_told, ramps_told


def law(group: str, *intervals: tuple[float, float], status: str = "fitted") -> dict[str, FittedParameter]:
    """Parameters of ``group`` by joint, with these intervals; 0 in the file."""
    return {f"{group}.{k}": FittedParameter((a + b) / 2, a, b, 0.0, status) for k, (a, b) in enumerate(intervals)}


@pytest.mark.parametrize("group", ["friction_slope", "stribeck", "backlash", "servo_zero", "ramp"])
def test_a_law_whose_values_all_may_be_0_is_named(group: str) -> None:
    moves = {"selection": [{"move": "add", "group": "all"}, {"move": "add", "group": group}]}
    parameters = law(group, (0.0, 0.02), (0.0, 0.3)) | law("frictionloss", (0.0, 1.0))
    assert doubtful_laws(parameters) == [group]
    assert f"({group}), but no value of it is told from 0" in (laws_told(parameters, moves) or "")
    assert laws_told(parameters, {"selection": moves["selection"][:1]}) is None  # asked for by name
    assert laws_told(parameters, {"selection": None}) is None


def test_a_law_that_one_joint_shows_is_believed() -> None:
    assert doubtful_laws(law("friction_slope", (-0.1, 0.2), (0.3, 0.5))) == []
    assert doubtful_laws(law("friction_slope", (0.0, 0.0), status="nominal")) == []
    assert laws_told({}, {"selection": [{"move": "add", "group": "stribeck"}]}) is None


def test_play_that_the_fit_has_closed_is_named() -> None:
    parameters = {
        "play.hip": FittedParameter(5e-4, 5e-4, 1e-3, 0.01, "at bound"),
        "play.knee": FittedParameter(0.02, 0.019, 0.021, 0.01, "fitted"),
        "play.toe": FittedParameter(0.2, 0.1, 0.2, 0.01, "at bound"),
    }
    assert "shows no play at hip: the gap" in (play_told(parameters) or "")
    assert play_told({"play.knee": parameters["play.knee"]}) is None


def test_rates_of_targets_are_told_as_rates() -> None:
    parameters = law("ramp", (0.4, 0.6), (0.0, 0.1))
    told = ramps_told(parameters) or ""
    assert told.endswith("in units of the control a second: 0 2 [1.67, 2.5]")
    assert ramps_told(law("ramp", (0.0, 0.0), status="nominal")) is None
