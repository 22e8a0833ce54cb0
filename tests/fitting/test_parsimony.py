"""What the selection tries: forecasts against refits, and sets of groups that only help together."""

from dataclasses import replace

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.choice.extension import Extension
from cmbrl.fitting.choice.forecast import Forecast, adjusted
from cmbrl.fitting.choice.parsimony import _needed
from cmbrl.fitting.choice.trials import Incumbent, Trial
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.folds import LEAST_GAIN, Folds, draw_starts
from cmbrl.fitting.search.loss_values import Errors
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.state import Journal
from cmbrl.models.windows import Scales


@pytest.fixture
def setup(carts):
    model = carts.model(2)
    data = carts.record(carts.truth(2, gear_1=0.9, tilt=0.1), episodes=12, steps=40, noise=2e-3)
    evidence = Evidence.of(model, data)
    space = evidence.space
    loss = evidence.loss(draw_starts(data, 1, 2000, 0), 1, Scales.of(model.scene, data, 2.0))
    return space, loss, Folds.of(loss, loss, 4, seed=0)


@pytest.mark.parametrize("groups", [["gear"], ["tilt"], ["gear", "tilt"], ["mass", "damping", "tilt"]])
def test_forecast_is_near_what_a_refit_gains(setup, groups):
    space, loss, folds = setup
    z, active = np.zeros(len(space)), space.columns(groups)
    strength = Objective.at(loss, space, active, z).strength
    forecast = Forecast.at(folds, space, z, strength).gain(active)
    fitted, _ = folds.refit(space, active, z, 10, Journal(None, "test"))
    before, after = folds.errors(space, [z] * 4), folds.errors(space, fitted)
    assert forecast == pytest.approx(before.mean - after.mean, rel=0.1)
    assert forecast > 0.02 * before.mean


def test_a_group_that_changes_no_prediction_is_blank_and_promises_nothing(setup):
    space, _, folds = setup
    forecast = Forecast.at(folds, space, np.zeros(len(space)), 1e-3)
    assert [g for g in dict.fromkeys(space.groups) if forecast.blank(space.columns([g]))] == ["bumper"]
    assert forecast.gain(space.columns(["bumper"])) == 0.0
    assert forecast.gain(np.zeros(len(space), dtype=bool)) == 0.0


def test_what_makes_up_for_a_group_follows_its_return(setup):
    """Masses, motors and friction at 1.5 times the file's predict as well: back with the motors, back with all."""
    space, loss, _ = setup
    groups = ("mass", "damping", "frictionloss", "gear")
    active, gone = space.columns(groups), space.columns(["gear"])
    nominal = space.theta(np.zeros(len(space)))
    z = space.z(np.where(active, 1.5 * nominal, nominal))
    equations = Objective.at(loss, space, active, z).normal_equations(z)
    followed = adjusted(z, active, gone, equations)
    before, naive, after = loss.values(space.theta(np.stack([z, np.where(gone, 0.0, z), followed])))
    assert np.all(followed[gone] == 0.0)
    assert after < before + 0.05 * (naive - before)
    told = space.theta(followed)[space.columns(["mass"])]  # the second motor of the log is at 0.9
    np.testing.assert_allclose(told, nominal[space.columns(["mass"])] / (1.0, 0.9), rtol=0.05)


def test_a_set_keeps_what_only_helps_together():
    def promise(groups):
        return 1.0 * ({"a", "b"} <= set(groups)) + 0.05 * ("c" in groups) + 0.2 * ("d" in groups)

    assert _needed(["a", "b", "c", "d"], promise, 0.1) == ["a", "b", "d"]
    assert _needed(["a", "c"], promise, 0.1) == []


def test_groups_that_help_only_together_are_added_as_one(carts, monkeypatch):
    """With the bar so high that no group alone gets over it, both of two are still found."""
    data = carts.record(carts.truth(2, gear_1=0.7, tilt=0.4), episodes=20, steps=40, noise=1e-3)
    alone = cmbrl.fit(carts.model(2), data, groups=["gear"]).report["loss"]
    fall = 1.0 - alone["held out, fitted"]["loss"] / alone["held out, nominal"]["loss"]
    assert fall < 0.9
    monkeypatch.setattr("cmbrl.fitting.choice.trials.Trial.counts", lambda trial, loss: trial.gain > 0.9 * loss)
    result = cmbrl.fit(carts.model(2), data)
    assert {"gear", "tilt"} <= {name.split(".")[0] for name in result.report["fitted"]}
    assert result.parameters["tilt"].value == pytest.approx(0.4, rel=0.02)


def test_parameters_that_make_up_for_another_are_no_saving():
    """Masses and motors at two fifths of the file's predict as damping at two and a half times it does."""
    errors = Errors(np.ones(1), np.ones(1), 0, 1.0)
    without = Trial(np.zeros(2), np.ones(2, dtype=bool), errors, 0.0, 0.0, 0.1, score=0.0, strain=9.0)
    assert without.costs_nothing(1.0, 0.0, strain=8.0)
    assert not without.costs_nothing(1.0, 0.0, strain=3.0)
    far = replace(without, strain=104.0)  # hundreds of parameters, none of which went far for this
    assert far.costs_nothing(1.0, 0.0, strain=100.0)
    assert not far.costs_nothing(1.0, 0.0, strain=90.0)


def test_two_groups_may_cost_what_two_are_worth():
    errors = Errors(np.ones(1), np.ones(1), 0, 1.0)
    without = Trial(np.zeros(2), np.ones(2, dtype=bool), errors, -1.5 * LEAST_GAIN, 0.0, 0.0, score=0.0, strain=0.0)
    assert without.costs_nothing(1.0, 0.0, 0.0, groups=2)
    assert not without.costs_nothing(1.0, 0.0, 0.0)


def test_a_law_that_shows_only_beside_another_is_tried_again(setup, monkeypatch):
    """The second says nothing until the first, which explains more, has been taken."""
    space, loss, folds = setup
    extension = Extension(space, loss, folds, [], 0, Budget(), Journal(None, ""))

    def law(_, incumbent, group, before):
        told = group == "tilt" or any(step["group"] == "tilt" for step in incumbent.path)
        active = incumbent.active | space.columns([group])
        return Trial(incumbent.z, active, before, float(told), 0.0, 0.0, 0.0, 0.0)

    monkeypatch.setattr("cmbrl.fitting.choice.extension.drives.GROUPS", ())
    monkeypatch.setattr("cmbrl.fitting.choice.extension.LAWS", ("gear", "tilt"))
    monkeypatch.setattr(Extension, "_law", law)
    monkeypatch.setattr(Extension, "_limited", lambda *_: None)
    monkeypatch.setattr(Extension, "_settled", lambda _, incumbent, before: before)
    incumbent = Incumbent(np.zeros(len(space)), np.zeros(len(space), dtype=bool))
    extension.extend(incumbent, space.columns(["mass"]))
    assert [step["group"] for step in incumbent.path][1:] == ["tilt", "gear"]


@pytest.mark.parametrize(
    ("chance", "factor", "helps"), [(0.1, 1.0, True), (0.1, 1.2, False), (1.1, 0.5, True), (1.1, 1.0, False)]
)
def test_a_start_of_chance_does_not_say_what_a_law_does_to_the_rest(setup, chance, factor, helps):
    """One start, which rules the mean, is predicted ``chance`` times as badly with the law, all others ``factor``."""
    space, loss, folds = setup
    extension = Extension(space, loss, folds, [], 0, Budget(), Journal(None, ""))
    calm = np.full(len(folds.blocks()), 1e-3)
    first = np.arange(len(calm)) == 0
    before, after = (
        Errors(np.where(first, x, y), calm, 0, 1.0) for x, y in ((10.0, calm), (10.0 * chance, factor * calm))
    )
    trial = Trial(np.zeros(2), np.ones(2, dtype=bool), after, before.mean - after.mean, 0.0, 0.0, 0.0, 0.0)
    assert trial.counts(before.mean) == (chance < 1.0)
    assert extension._helps(trial, before) == helps
    assert extension._helps(trial, before, "backlash") == (helps and chance < 1.0)  # as friction stands for it


@pytest.mark.parametrize(
    ("gain", "noise", "law", "fit"), [(0.3, 0.05, True, True), (0.05, 0.0, False, True), (0.3, 0.12, False, True)]
)
def test_a_law_has_to_gain_more_than_a_further_fit(setup, gain, noise, law, fit):
    """A tenth of the loss, and three times its noise: what is worth a parameter of the file is not yet worth a law."""
    space, loss, folds = setup
    extension = Extension(space, loss, folds, [], 0, Budget(), Journal(None, ""))
    calm = np.full(len(folds.blocks()), 1e-3)
    before = Errors(calm, calm, 0, 1.0)
    first = np.arange(len(calm)) == 0  # so that the usual part says nothing
    after = Errors(np.where(first, calm * (1.0 - gain * len(calm)), calm), calm, 0, 1.0)
    trial = Trial(np.zeros(2), np.ones(2, dtype=bool), after, gain * 1e-3, noise * 1e-3, 0.0, 0.0, 0.0)
    assert extension._helps(trial, before, "stribeck") == law
    assert extension._helps(trial, before) == fit


@pytest.mark.parametrize("gap", [False, True])
def test_a_gap_that_only_the_usual_part_of_a_log_calls_for_goes(setup, monkeypatch, gap):
    """Without it all starts but one, which rules the mean, are predicted 1.2 times as badly: friction may do that."""
    space, loss, folds = setup
    calm = np.full(len(folds.blocks()), 1e-3)
    first = np.arange(len(calm)) == 0
    kept, without = (Errors(np.where(first, x, y), calm, 0, 1.0) for x, y in ((10.0, calm), (9.9, 1.2 * calm)))
    assert without.mean < kept.mean

    def trial(_, name, incumbent, active, start, none, before, *__):
        errors = kept if name.startswith("confirmed") else without
        return Trial(start, active, errors, before.mean - errors.mean, 0.0, 0.0, 0.0, 0.0)

    monkeypatch.setattr(Extension, "_trial", trial)
    monkeypatch.setattr("cmbrl.fitting.choice.extension.drives.rubbing", lambda _, __, ___, point: point)
    monkeypatch.setattr("cmbrl.fitting.choice.extension._STANDS_FOR", frozenset({"tilt"} if gap else {"backlash"}))
    incumbent = Incumbent(np.full(len(space), 0.1), space.columns(["mass", "tilt"]))
    Extension(space, loss, folds, [], 0, Budget(), Journal(None, "")).confirm(incumbent, ["tilt"])
    assert incumbent.active[space.columns(["tilt"])].all() != gap
    assert [step["move"] for step in incumbent.path] == ["remove"] * gap


def test_what_is_compared_weighs_the_prior_alike(setup, monkeypatch):
    """Fits without a fold, which come first, as the fit of all does; those with a law as the one without."""
    space, loss, folds = setup
    extension = Extension(space, loss, folds, [], 0, Budget(), Journal(None, ""))
    weights, limited, refit = [], [], Folds.refit

    def refitted(self, *args):
        weights.append(args[-1])
        return refit(self, *args)

    monkeypatch.setattr(Folds, "refit", refitted)
    monkeypatch.setattr(Extension, "_limited", lambda _, law, incumbent, *__: limited.append(incumbent.least))
    monkeypatch.setattr(Extension, "_settled", lambda _, incumbent, before: before)
    monkeypatch.setattr(Extension, "_hopeful", lambda *_: [])
    incumbent = Incumbent(np.zeros(len(space)), np.zeros(len(space), dtype=bool))
    extension.extend(incumbent, space.columns(["mass"]))
    assert weights == [incumbent.least]
    assert set(limited) == {incumbent.least}  # one of every law of limits
    assert incumbent.least > 0.0


def test_a_trial_in_which_motion_explodes_says_nothing_for_itself(setup):
    space, loss, folds = setup
    extension = Extension(space, loss, folds, [], 0, Budget(), Journal(None, ""))
    incumbent = Incumbent(np.zeros(len(space)), space.columns(["mass"]))
    before, none = extension._unmoved(incumbent), np.zeros(len(space), dtype=bool)
    start = np.where(space.columns(["gear"]), np.nan, 0.0)  # forces that are not finite, as of servos on light links
    trial = extension._trial("remove", incumbent, incumbent.active, start, none, before)
    assert np.isnan(trial.errors.loss).any()
    assert not trial.counts(before.mean)
    assert not trial.costs_nothing(before.mean, np.inf, np.inf)
    assert not extension._helps(trial, before)
