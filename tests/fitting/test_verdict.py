"""What a fit says first: where it loses, by the measures that the user sees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.compare import compare
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.outcome.first_line import first_line
from cmbrl.fitting.outcome.report_text import render
from cmbrl.fitting.outcome.unseen_errors import by_chance, by_horizon
from cmbrl.fitting.outcome.verdict import lost, remark, warning
from cmbrl.fitting.search.unseen import Unseen

from .arm_log import followed
from .test_fit_hidden import recorded, scene

ARM = """<mujoco><option timestep=".01"/><worldbody><body pos="0 0 1"><joint name="a" type="hinge" axis="0 1 0"
damping=".1"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4"/><body pos="0 0 -.4"><joint name="b" type="hinge"
axis="0 1 0" damping=".1"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4"/></body></body></worldbody>
<actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""
QUICK = Budget(survey_rows=300, trial_rows=300, held_out_rows=300, polish_rows=300, starts=1)


def _row(steps: int, rmse: tuple[float, float, float], loss: tuple[float, float, float]) -> dict:
    names = ("hold", "nominal", "fitted")
    return {
        "steps": steps,
        "rmse": dict(zip(names, rmse, strict=True)),
        "loss": dict(zip(names, loss, strict=True)),
    }


def test_a_fit_that_loses_says_so_first() -> None:
    rows = [_row(1, (1.0, 0.5, 0.6), (1.0, 0.5, 0.6)), _row(20, (0.5, 2.0, 0.6), (0.5, 2.0, 0.6))]
    text = warning(rows)
    assert text is not None
    assert "holding the velocity over 20 step(s), and to the file as it is over 1 step(s)" in text
    assert warning([_row(1, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))]) is None


def test_holding_is_no_rival_where_it_tells_nothing() -> None:
    """A robot that falls within two seconds: the fit is ten times better where anything can be predicted."""
    rows = [_row(20, (1.5, 1.3, 0.2), (21.0, 16.0, 0.4)), _row(100, (6.4, 34.0, 6.6), (86.0, 342.0, 35.0))]
    assert warning(rows) is None
    assert [lost(row) for row in rows] == [False, True]
    assert warning([_row(100, (0.9, 34.0, 6.6), (1.0, 342.0, 35.0))]) is not None
    assert warning([_row(1, (1.2, 3.0, 1.3), (1.2, 3.0, 1.3))]) is not None  # in units of the change
    assert warning([_row(100, (6.4, 5.0, 6.6), (86.0, 5.0, 35.0))]) is not None  # the file is a rival everywhere


def test_what_may_be_chance_is_no_reason_for_distrust() -> None:
    """A box is pushed in one part of eight, which rules the mean; the others are predicted better."""
    row = _row(351, (5.7, 0.24, 0.25), (6.5, 0.15, 0.165)) | {"estimated": True}
    both = {"chance": {"rmse": True, "loss": True}}
    assert warning([row]) is not None
    assert warning([row | {"chance": {"rmse": True, "loss": False}}]) is not None  # by one measure it is no chance
    assert warning([row | both]) is None
    assert remark([row | both]) == " It loses by no more than chance to the file as it is over 351 step(s)."
    far = _row(351, (5.7, 0.24, 0.35), (6.5, 0.15, 0.165)) | both  # as one that falls in one part of eight
    assert warning([far]) is not None
    parts = np.repeat(np.arange(8), 4)
    before, after = (np.where(parts == 7, *each) for each in ((0.40, 8e-4), (0.45, 4e-4)))
    assert by_chance(before, after, parts)
    assert not by_chance(before, 1.1 * before + 0.01, parts)  # alike in all parts
    assert not by_chance(before, np.where(parts == 7, np.inf, 0.0), parts)
    assert not by_chance(before, after, np.zeros(32, dtype=int))  # one part tells nothing of chance


def test_a_file_that_tells_less_than_holding_is_no_rival() -> None:
    """Of 1.6 s under torques, which nothing holds: file and fit are off by more than the states vary."""
    assert warning([_row(1616, (1.78, 1.9, 2.26), (3.2, 3.1, 4.1))]) is None
    assert warning([_row(1616, (2.0, 1.9, 2.26), (3.2, 3.1, 4.1))]) is not None  # the file tells more than holding
    assert warning([_row(1616, (0.78, 0.9, 1.26), (3.2, 3.1, 4.1))]) is not None  # the file tells something
    assert warning([_row(1616, (1.78, 1.9, 1e6), (3.2, 3.1, 4e6))]) is not None  # the fit explodes


def test_a_fit_that_hardly_gains_over_holding_says_so() -> None:
    """Of a log of torques that do not explain the motion, parameters that slow it down explain most."""
    rows = [_row(1, (0.71, 43.0, 0.63), (1.9, 111.0, 1.3)), _row(20, (0.058, 1.3, 0.053), (1.9, 53.0, 1.3))]

    def line(rows: list[dict]) -> str:
        loss = {"held out, nominal": {"rmse": 224.0}, "held out, fitted": {"rmse": 7.5}}
        told = {"stopped": None, "fitted": ["mass.a"], "horizon": 20, "loss": loss, "horizons": rows, "at_bound": []}
        return first_line(told | {"data": {"transitions": 5000, "dt": 0.005}})

    assert "at most 1.13 times better than holding the velocity" in line(rows)
    assert "holding" not in line([*rows, _row(100, (0.26, 2.4, 0.1), (2.1, 24.0, 0.5))])  # half a second is explained
    assert "holding" not in line([row | {"estimated": True} for row in rows])  # velocities are estimates


def test_a_file_that_is_exact_is_no_rival() -> None:
    """What both leave is rounding, which a chaotic robot makes large in a second."""
    exact = [_row(1, (1.1, 2.6e-8, 2.7e-8), (6.0, 6e-15, 7e-15)), _row(20, (0.9, 4e-5, 5e-5), (9.0, 8e-9, 9e-9))]
    assert warning(exact) is None
    assert warning([_row(1, (1.1, 2.6e-8, 2e-6), (6.0, 6e-15, 7e-12)), exact[1]]) is not None


def test_it_loses_where_one_measure_says_so() -> None:
    """Usual errors fall, large ones rise: the table of ``cmbrl error`` shows a loss."""
    text = warning([_row(1, (9.0, 0.5, 0.6), (9.0, 0.5, 0.4)), _row(5, (9.0, 0.5, 0.4), (9.0, 0.5, 0.6))])
    assert text is not None
    assert text.endswith("the file as it is over 1 step(s) by RMSE and 5 step(s) by Huber loss")


def test_what_it_loses_hardly_over_one_step_alone_is_told_without_alarm() -> None:
    """An impact and a velocity that was estimated rule the RMSE of one step; usual errors and longer ones fall."""
    rows = [_row(1, (0.72, 0.142, 0.155), (0.5, 0.0298, 0.0291)), _row(20, (1.05, 0.149, 0.047), (1.0, 0.03, 0.003))]
    assert warning(rows) is None
    assert remark(rows) == " It loses a little to the file as it is over 1 step(s) by RMSE."
    assert remark(rows[1:]) == ""
    for loud in (
        rows[:1],  # nothing longer is gained
        [_row(1, (0.72, 0.142, 0.18), (0.5, 0.0298, 0.0291)), rows[1]],  # not a little
        [_row(1, (0.72, 0.142, 0.155), (0.5, 0.0298, 0.031)), rows[1]],  # by both measures
        [*rows, _row(100, (3.0, 0.5, 0.6), (2.0, 0.5, 0.4))],  # and over a long horizon
    ):
        assert "DO NOT TRUST" in (warning(loud) or "")
        assert remark(loud) == ""


def test_the_errors_are_those_of_the_table_of_errors(tmp_path: Path) -> None:
    """Of the whole log as unseen: the user who asks ``cmbrl error`` gets the same numbers."""
    model, log = cmbrl.ComplementarityModel(scene(tmp_path, ARM)), recorded(ARM, 1, 3, 120, 0, 1.0)
    evidence = Evidence.of(model, log)
    theta, every = evidence.space.nominal.copy(), np.arange(len(log))
    theta[evidence.space.columns(["damping", "mass"])] *= 0.8
    unseen = Unseen(evidence.log, evidence.observation, 1, evidence.space.nominal, (every,), (theta,))
    rows = by_horizon(evidence, unseen, 0.5)
    fitted = evidence.model.with_parameters(evidence.observation.split(theta)[0])
    table = compare({"nominal": evidence.model, "fitted": fitted}, log, model.scene)
    assert [row["steps"] for row in rows] == [1, 5, 20, 100]
    for row in rows:
        for name in ("nominal", "fitted"):
            assert row["rmse"][name] == pytest.approx(table.entry(name, row["steps"]).error, rel=0.05)
        assert len(row["by_channel"]) == 2 * model.scene.nv
        assert np.sqrt(np.square(row["by_channel"]).mean()) == pytest.approx(row["rmse"]["fitted"])


@pytest.mark.parametrize(("damping", "worse"), [(2.0, False), (0.2, True)])
def test_fits_of_positions_are_judged_over_parts_of_the_log(tmp_path: Path, damping: float, worse: bool) -> None:
    """Half a second tells little of damping; the file has half of the true one."""
    servos = ARM.replace("<motor", '<position kp="5"').replace('".01"', '".002"')
    log = followed(servos.replace('".1"', '".2"'), 900)
    evidence = Evidence.of(cmbrl.ComplementarityModel(scene(tmp_path, servos)), log)
    theta, rows = evidence.space.nominal.copy(), np.arange(len(evidence.log))
    theta[evidence.space.columns(["damping"])] *= damping
    parts = tuple(rows[rows * 8 // len(rows) % 2 == k] for k in (0, 1))
    unseen = Unseen(evidence.log, evidence.observation, 50, evidence.space.nominal, parts, (theta, theta))
    (row,) = by_horizon(evidence, unseen, 0.5)
    assert row["steps"] == 101
    told = warning([row])
    assert (told is not None and "it loses to the file as it is over 101 step(s)" in told) is worse
    assert warning([{**row, "rmse": {**row["rmse"], "hold": 0.0}}]) == told


def test_the_first_line_of_a_fit_tells_of_a_loss_in_rmse(carts) -> None:
    data = carts.record(carts.truth(2, gear_1=0.7, tilt=0.4), episodes=8, steps=40, noise=1e-3)
    result = cmbrl.fit(carts.model(2), data, budget=QUICK)
    report = dict(result.report)
    assert "times better" in first_line(report)
    few = {**report, "data": {**report["data"], "transitions": 3}}
    assert "; 3 transitions tell little: record more." in first_line(few)
    assert "tell little" not in first_line(report)
    far = report["horizons"][-1]["rmse"]
    assert f" times over 20 steps (0.4 s): {far['fitted']:.3g} instead of {far['nominal']:.3g}" in first_line(report)
    beyond = [
        *report["horizons"],
        {**report["horizons"][-1], "steps": 100, "rmse": {"hold": 7, "nominal": 9, "fitted": 6}},
    ]
    assert first_line({**report, "horizons": beyond}).endswith(
        "Over 100 steps (2 s) it is off by more than the states vary: use it for less."
    )
    little = {**beyond[0], "rmse": {**beyond[0]["rmse"], "fitted": 1.1 * beyond[0]["rmse"]["nominal"]}}
    assert first_line({**report, "horizons": [little, *beyond[1:]]}).endswith(
        "use it for less. It loses a little to the file as it is over 1 step(s) by RMSE."
    )
    worse = [{**row, "rmse": {**row["rmse"], "fitted": 2.0 * row["rmse"]["nominal"]}} for row in report["horizons"]]
    assert "DO NOT TRUST" in first_line({**report, "horizons": worse}).split(".")[0]
    hasty = {"limit": 250.0, "asked": False, "shares": {"choice": 0.0625, "polish": 0.044, "held out": 0.02}}
    assert "by RMSE; it did 4% of its usual work: give it --time-limit" in first_line(
        {**report, "horizons": [little, *beyond[1:]], "pace": hasty}
    )
    assert first_line({**report, "horizons": worse, "pace": hasty}).endswith(
        "; it did 4% of its usual work: give it --time-limit 5700."
    )
    assert "--time-limit" not in first_line({**report, "pace": hasty})
    assert not first_line({**report, "horizons": worse, "pace": {**hasty, "shares": {"report": 0.1}}}).count("limit")
    assert "fitted, rmse" in render(result.parameters, report)
    exact = {f"held out, {of}": {"rmse": error} for of, error in (("nominal", 2e-7), ("fitted", 1e-7))}
    assert "about as well as the file" in first_line({**report, "loss": exact, "horizons": []})


def test_a_file_that_is_right_stays_as_it_is(tmp_path: Path) -> None:
    """Differences of the size of the solver's accuracy are no reason to move a parameter."""
    model, log = cmbrl.ComplementarityModel(scene(tmp_path, ARM)), recorded(ARM, 1, 8, 60, 0, 1.0)
    nearly = np.array(
        [
            x * (1.00002 if p.group == "gear" else 1.0)
            for p, x in zip(model.scene.parameters, model.parameters, strict=True)
        ]
    )
    same = model.with_parameters(nearly).for_log(log.dt).predict(log.q, log.v, log.u)
    log = replace(log, q_next=same.q_next, v_next=same.v_next, episode=np.arange(len(log)))
    result = cmbrl.fit(model, log, budget=QUICK)
    assert result.report["fitted"] == []
    assert first_line(result.report).startswith("Nothing was fitted")


def test_holding_is_no_rival_where_the_noise_of_the_sensors_rules(tmp_path: Path) -> None:
    """Of a log that rests under noise, the estimate of the holder's error is its error."""
    model, log = cmbrl.ComplementarityModel(scene(tmp_path, ARM)), recorded(ARM, 1, 3, 120, 0, 1.0)
    noise, rng = np.array([[1e-4, 2e-4, 1e-2, 2e-2]]), np.random.default_rng(0)
    q, v = (noise[0, part] * rng.normal(size=(len(log) + 1, 2)) for part in (slice(2), slice(2, 4)))
    log = replace(log, q=q[:-1], q_next=q[1:], v=v[:-1], v_next=v[1:], episode=np.zeros(len(log)))
    evidence, every = Evidence.of(model, log), np.arange(len(log))
    unseen = Unseen(evidence.log, evidence.observation, 1, evidence.space.nominal, (every,), (evidence.space.nominal,))
    rows = by_horizon(evidence, unseen, 0.5, noise=noise)
    for row in rows[:2]:
        assert row["noise"] == pytest.approx(row["rmse"]["hold"], rel=0.1)
    row = {**rows[0], **{of: {"hold": 0.8, "nominal": 4.0, "fitted": 1.0} for of in ("rmse", "loss")}}
    assert warning([{**row, "noise": 0.7}]) is None
    assert "loses to holding the velocity over 1 step(s)" in str(warning([{**row, "noise": 0.1}]))
    row = rows[0] | {of: {"hold": 0.8, "nominal": 0.7, "fitted": 0.75} for of in ("rmse", "loss")} | {"chance": {}}
    assert warning([{**row, "noise": 0.6}]) is None
    assert "loses to the file as it is over 1 step(s)" in str(warning([{**row, "noise": 0.1}]))


@pytest.mark.parametrize(("fitted", "told"), [(0.64, False), (0.75, False), (0.85, True), (1.58, True)])
def test_noise_of_the_file_excuses_no_fit_that_errs_by_far_more(fitted: float, told: bool) -> None:
    """As of a robot on wheels: the file erred by little more than the noise, and the fit by nine times its square."""
    errors = {"hold": 15.0, "nominal": 0.64, "fitted": fitted}
    row = {"steps": 20, "rmse": errors, "loss": errors, "noise": 0.52}
    assert (warning([row]) is not None) == told
    assert told == ("the file as it is over 20 step(s)" in str(warning([row])))
