"""The whole procedure on carts: parsimony, reproducibility, resuming, stopping, bad input."""

import json

import numpy as np
import pytest

import cmbrl
from cmbrl.errors import UserError
from cmbrl.fitting import FittedParameter
from cmbrl.fitting import state as state_module
from cmbrl.fitting.outcome import report_text

from .conftest import QUICK


@pytest.fixture(scope="module")
def data(two_carts):
    return two_carts


def _values(result):
    return {name: p.value for name, p in result.parameters.items()}


def test_fits_what_differs_and_nothing_else(whole_fit):
    result = whole_fit
    for name, truth in {"gear.1": 0.7, "tilt": 0.4}.items():
        parameter = result.parameters[name]
        assert parameter.value == pytest.approx(truth, rel=0.02)
        assert parameter.low <= truth <= parameter.high
        assert parameter.status == "fitted"
    assert {name.split(".")[0] for name in result.report["fitted"]} == {"gear", "tilt"}
    kept = result.parameters["mass.0"]
    assert kept.status == "nominal"
    assert kept.to_dict() == {**kept.to_dict(), "low": None, "high": None}  # not known to be what it was left at
    assert np.isnan(FittedParameter.from_dict(kept.to_dict()).low)
    assert result.report["unseen"] == ["bumper"]
    loss = result.report["loss"]
    assert loss["held out, fitted"]["rmse"] < 0.2 * loss["held out, nominal"]["rmse"]
    assert result.report["left_out"] == [{"kind": "tendon", "name": "rope", "why": "not modelled"}]


def test_a_perfect_model_is_left_alone(carts):
    result = cmbrl.fit(carts.model(), carts.record(carts.model(), 10, 30, noise=1e-3), budget=QUICK)
    assert result.report["fitted"] == []
    assert np.array_equal(result.model.parameters, carts.model().parameters)
    assert "none: the nominal model" in result.report_text()


@pytest.mark.parametrize("method", ["random", "cma", "gauss-newton"])
def test_every_method_fits_all_parameters(carts, data, method):
    result = cmbrl.fit(carts.model(2), data, method=method, groups="all", budget=QUICK)
    gear, mass = (result.parameters[f"{name}.1"] for name in ("gear", "mass"))
    assert gear.value / mass.value == pytest.approx(0.7, rel=0.04)  # the unit of force is the file's, not the log's
    assert gear.low < 0.7 < gear.high
    assert mass.low < 1.0 < mass.high
    assert {"mass.0", "mass.1", "gear.1"} <= set(result.report["gauge"])
    assert result.parameters["bumper"].status == "flat"
    assert {"bumper": 1.0} in [d["parameters"] for d in result.report["flat_directions"]]
    json.dumps(result.report, allow_nan=False)
    assert all(name in result.report_text() for name in ("damping.0", "flat directions", "rope"))


def test_named_groups_over_several_steps(carts, data):
    result = cmbrl.fit(carts.model(2), data, groups=["damping.0", "gear", "tilt"], horizon=4, budget=QUICK)
    assert result.report["fitted"] == ["damping.0", "gear.0", "gear.1", "tilt"]
    assert result.parameters["gear.1"].value == pytest.approx(0.7, rel=0.02)


def test_start_of_the_model_is_the_prior(carts, data):
    wrong = carts.truth(2, damping_0=0.8, gear_1=1.3)
    result = cmbrl.fit(wrong, data, groups=["damping", "gear", "tilt"], budget=QUICK)
    assert result.parameters["gear.1"].nominal == 1.3
    assert result.parameters["gear.1"].value == pytest.approx(0.7, rel=0.02)


def test_same_seed_same_fit(carts, data, whole):
    first, again, other = whole, *(cmbrl.fit(carts.model(2), data, seed=s, budget=QUICK) for s in (0, 4))
    assert _values(first) == _values(again)
    assert first.report["loss"] == again.report["loss"]
    assert first.report["loss"] != other.report["loss"]  # other candidates, other folds


class Killed(BaseException):
    """Stands for the end of the process: nothing may catch it."""


def _killed_after(model, calls, error, times=1000):
    whole, left = model.candidate_losses, [times]

    def candidate_losses(*arguments):
        if model.calls >= calls and left[0]:
            left[0] -= 1
            raise error
        return whole(*arguments)

    model.candidate_losses = candidate_losses
    return model


@pytest.fixture(scope="module")
def whole(quick_fit):
    return quick_fit


@pytest.mark.parametrize("calls", [20, 100, 180])
def test_a_killed_fit_resumes_to_the_same_result(carts, data, whole, tmp_path, monkeypatch, calls):
    monkeypatch.setattr(state_module, "_SECONDS_BETWEEN_WRITES", 0.0)
    with pytest.raises(Killed):
        cmbrl.fit(_killed_after(carts.model(2), calls, Killed()), data, budget=QUICK, folder=tmp_path)
    model = carts.model(2)
    resumed = cmbrl.fit(model, data, budget=QUICK, folder=tmp_path)
    assert _values(resumed) == _values(whole)
    assert resumed.report["candidates"] == whole.report["candidates"]
    assert (whole.report["resumed"], resumed.report["resumed"]) == (False, True)
    done = cmbrl.fit(carts.model(2), data, budget=QUICK, folder=tmp_path)
    assert _values(done) == _values(whole)
    assert [p.name for p in tmp_path.iterdir()] == ["state.json"]


@pytest.mark.parametrize("calls", [0, 100, 180])
def test_ctrl_c_leaves_the_best_so_far(carts, data, calls):
    model = _killed_after(carts.model(2), calls, KeyboardInterrupt())
    result = cmbrl.fit(model, data, budget=QUICK)
    assert result.report["stopped"] == "interrupted"
    loss = result.report["loss"]
    assert loss["all, fitted"]["loss"] <= loss["all, nominal"]["loss"]
    assert "STOPPED EARLY (interrupted)" in result.report_text()


@pytest.mark.parametrize("calls", [0, 180])
def test_a_stopped_fit_shows_held_out_errors(carts, data, calls):
    model = _killed_after(carts.model(2), calls, KeyboardInterrupt(), times=1)
    result = cmbrl.fit(model, data, budget=QUICK)
    assert result.report["stopped"] == "interrupted"
    loss = result.report["loss"]
    assert loss["held out, fitted"]["loss"] <= loss["held out, nominal"]["loss"]
    assert "held out, fitted" in result.report_text()


def test_long_lists_of_the_report_are_folded():
    names = [f"damping.a_rather_long_joint_name_{k}" for k in range(41)]
    parameters = {name: FittedParameter(1.0, 0.5, 2.0, 1.0, "flat") for name in names}
    parameters["mass.torso"] = FittedParameter(1.2, 1.1, 1.3, 1.0, "fitted", "1")
    row = {"rmse": 0.1, "loss": 0.2, "failures": 0}
    report = {
        "data": {"transitions": 9, "episodes": 3}, "method": "random", "seed": 0, "seconds": {"total": 1.0},
        "candidates": 5, "horizon": 1, "horizons": [], "stepping": [], "noise": None,
        "loss": {"all, fitted": row}, "stopped": None, "selection": None,
        "flat_directions": [{"parameters": {name: 1.0}} for name in names],
        "at_bound": [], "unseen": names, "gauge": ["mass.foot"],
        "left_out": [{"kind": "tendon", "name": name, "why": "ignored"} for name in names],
    }  # fmt: skip
    text = report_text.render(parameters, report)
    assert "41 parameters flat" in text
    assert " ".join(text.split()).count("and 38 more (--json lists all)") == 4
    assert "mass.foot" in text
    assert names[3] not in text
    assert max(map(len, text.splitlines())) <= 100


def test_a_long_table_shows_what_differs_most_clearly():
    parameters = {f"damping.{k}": FittedParameter(1.0 + 0.01 * k, 0.5, 2.0, 1.0, "fitted", "1") for k in range(80)}
    parameters |= {f"mass.{k}": FittedParameter(2.0, 1.9, 2.1, 1.0, "fitted", "1") for k in range(3)}
    row = {"rmse": 0.1, "loss": 0.2, "failures": 0}
    joints = [f"inertia felt by {k}" for k in range(30)]
    report = {
        "data": {"transitions": 9, "episodes": 3}, "method": "random", "seed": 0, "seconds": {"total": 1.0},
        "candidates": 5, "horizon": 1, "loss": {"all, fitted": row}, "stopped": None, "selection": None,
        "flat_directions": [], "at_bound": [], "unseen": [], "gauge": [], "left_out": [],
        "combinations": {"reference": None, "rows": [
            {"name": name, "value": 1.0, "low": 0.9, "high": 1.1, "nominal": 1.0, "unit": "1"} for name in joints
        ]},
    }  # fmt: skip
    text = report_text.render(parameters, report)
    assert all(f"mass.{k} " in text for k in range(3))
    assert "damping.79" in text
    assert "damping.5 " not in text
    assert "and 59 more" in text
    assert len(text.splitlines()) < 60
    whole = report_text.render(parameters, report, whole=True)
    assert all(name in whole for name in (*parameters, *joints))


def test_time_limit(carts, data, tmp_path):
    result = cmbrl.fit(carts.model(2), data, time_limit=0.0, folder=tmp_path)
    assert result.report["stopped"] == "time limit"
    resumed = cmbrl.fit(carts.model(2), data, folder=tmp_path)
    assert resumed.report["stopped"] is None


def test_progress_runs_to_the_end(carts, data):
    told = []
    cmbrl.fit(carts.model(2), data, budget=QUICK, progress=lambda done, text: told.append((done, text)))
    fractions = [done for done, _ in told]
    assert fractions == sorted(fractions)
    assert told[-1] == (1.0, "done")


def test_one_episode_only(carts):
    """Its parts are held out in turn."""
    data = carts.record(carts.truth(1, damping_0=2.0), 1, 200)
    result = cmbrl.fit(carts.model(), data, budget=QUICK)
    assert result.report["folds"] == 4
    assert result.parameters["damping.0"].value == pytest.approx(2.0, rel=1e-3)
    assert result.report["loss"]["held out, fitted"]["rmse"] < 1e-3
    without = cmbrl.fit(carts.model(), data, groups=["damping"], holdout=0.0)
    assert without.report["folds"] == 0
    assert "held out, fitted" not in without.report["loss"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "cmma"}, "did you mean 'cma'"),
        ({"groups": ["dampng"]}, "did you mean 'damping'"),
        ({"holdout": 1.5}, "holdout is 1.5"),
        ({"holdout": 0.0}, "selecting parameters needs held-out episodes"),
        ({"horizon": 99}, "no episode has 99 consecutive transitions"),
    ],
)
def test_bad_options(carts, data, options, message, tmp_path):
    with pytest.raises(UserError, match=message):
        cmbrl.fit(carts.model(2), data, folder=tmp_path, **options)
    assert not list(tmp_path.iterdir())


def test_folder_of_another_fit(carts, data, tmp_path):
    cmbrl.fit(carts.model(2), data, groups=["tilt"], budget=QUICK, folder=tmp_path)
    with pytest.raises(UserError, match="belongs to another fit"):
        cmbrl.fit(carts.model(2), data, groups=["gear"], budget=QUICK, folder=tmp_path)
    (tmp_path / "state.json").write_text("{")
    with pytest.raises(UserError, match="not readable as JSON"):
        cmbrl.fit(carts.model(2), data, groups=["tilt"], budget=QUICK, folder=tmp_path)


def test_a_robot_that_has_changed_is_another_fit(tmp_path):
    """Also by what no parameter is, such as a limit."""
    robot = """<mujoco><option timestep="0.01"/><worldbody><body><joint name="swing" axis="0 1 0" damping="0.1"
        range="-{} {}" limited="true"/><geom type="sphere" size="0.1" pos="0.3 0 0" mass="1"/></body></worldbody>
        </mujoco>"""
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(robot.format(170, 170)))
    rows, rng = [], np.random.default_rng(0)
    for _ in range(8):
        q, v = rng.normal(size=(1, 1)), rng.normal(size=(1, 1))
        for _ in range(30):
            after = model.predict(q, v, np.zeros((1, 0)))
            rows.append((q[0], v[0], after.q_next[0], after.v_next[0]))
            q, v = after.q_next, after.v_next
    q, v, q_next, v_next = map(np.array, zip(*rows, strict=True))
    log = cmbrl.Transitions(
        q=q, v=v, u=np.zeros((240, 0)), q_next=q_next, v_next=v_next, dt=0.01, episode=np.arange(240) // 30
    )
    options = {"groups": ["damping"], "budget": QUICK, "folder": tmp_path}
    first = cmbrl.fit(model, log, **options)
    assert cmbrl.fit(model, log, **options).parameters == first.parameters
    changed = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(robot.format(160, 170)))
    with pytest.raises(UserError, match="belongs to another fit"):
        cmbrl.fit(changed, log, **options)


def test_log_of_another_robot(carts, data):
    with pytest.raises(UserError, match="another robot"):
        cmbrl.fit(carts.model(3), data)
