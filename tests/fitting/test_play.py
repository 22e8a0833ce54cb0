"""Play between motor and link: written into a file, followed along a log that does not tell it, and fitted."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.compare import compare
from cmbrl.cli.main import main
from cmbrl.contact import Barrier, Exact
from cmbrl.contact.smoothing import Smoothing
from cmbrl.data.position_log import PositionLog
from cmbrl.data.several import together
from cmbrl.data.transitions import Transitions
from cmbrl.data.unlogged import unlogged, with_columns
from cmbrl.errors import UserError
from cmbrl.fitting import Budget
from cmbrl.fitting.choice.play_shown import gaps_to_try
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.played import BETTER, fit_or_played, keep, with_play
from cmbrl.fitting.result import FitResult
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import INTEGRATORS
from cmbrl.scene import Scene
from cmbrl.scene.writing.fitted_file import fitted_file
from cmbrl.scene.writing.played import gaps_of, played_file

from .played_arm import ARM, recorded

GAP = 0.03  # rad


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


def played(arm: Path, gap: float = GAP) -> Scene:
    path = arm.with_name("played.xml")
    path.write_text(played_file(arm, {"a": gap, "b": gap}))
    return Scene.from_mjcf(path)


def like_mujoco(scene: Scene) -> ComplementarityModel:
    return ComplementarityModel(scene, 4, sliding="convex")


@pytest.mark.parametrize("angle", ["radian", "degree"])
def test_the_motor_keeps_what_is_its_own_and_the_link_is_free_within_the_gap(angle: str, arm: Path) -> None:
    arm.write_text(ARM.replace("radian", angle))
    text = played_file(arm, {"b": GAP})
    model, before = mujoco.MjModel.from_xml_string(text), mujoco.MjModel.from_xml_string(arm.read_text())
    play = model.joint("b_play")
    np.testing.assert_allclose(play.range, [-GAP / 2, GAP / 2], rtol=1e-5)
    assert (play.bodyid, play.damping, play.armature, play.frictionloss) == (model.joint("b").bodyid, 0.0, 0.0, 0.0)
    for field in ("range", "armature", "damping"):
        np.testing.assert_allclose(getattr(model.joint("b"), field), getattr(before.joint("b"), field), rtol=1e-5)
    assert [model.actuator(k).trnid[0] for k in range(2)] == [model.joint(name).id for name in ("a", "b")]


def test_what_mujoco_says_of_the_file_is_not_said_again(arm: Path) -> None:
    arm.write_text(ARM.replace("<compiler", '<compiler settotalmass="3"'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "b_play" in played_file(arm, {"b": GAP})


def test_a_fit_may_move_the_gap_and_nothing_else_of_a_play(arm: Path) -> None:
    scene = played(arm)
    assert [p.name for p in scene.parameters if "play" in p.name] == ["play.a", "play.b"]
    assert not [name for name in (p.name for p in like_mujoco(scene).observer.parameters) if "play" in name]
    theta = scene.parameter_vector()
    theta[[p.name == "play.b" for p in scene.parameters]] = 0.012
    file = fitted_file(scene, theta)
    assert file.missing == ()
    model = mujoco.MjModel.from_xml_string(file.text)
    np.testing.assert_allclose(model.joint("b_play").range, [-0.006, 0.006], rtol=1e-5)
    np.testing.assert_allclose(model.joint("a_play").range, [-GAP / 2, GAP / 2], rtol=1e-5)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("smoothing", [Exact(), Barrier(1e-4)], ids=["exact", "barrier"])
def test_derivatives_in_the_gap_are_those_of_differences(smoothing: Smoothing, integrator: str, arm: Path) -> None:
    scene = played(arm)
    options = {"smoothing": smoothing, "integrator": integrator, "path_tolerance": 1e-12}
    model, theta = ComplementarityModel(scene, 2, **options), scene.parameter_vector()
    draw, gaps = np.random.default_rng(0), [k for k, p in enumerate(scene.parameters) if p.group == "play"]
    q, v, u = draw.normal(size=(60, 4)), draw.normal(size=(60, 4)), draw.uniform(-1, 1, (60, 2))
    q[:, [1, 3]] = draw.choice([-1, 1], (60, 2)) * draw.uniform(0.4, 0.52, (60, 2)) * GAP
    first = 2 * scene.nv + scene.nu
    found = model.predict(q, v, u, parameter_jacobian=np.array(gaps)).jacobian[:, :, first:]
    assert (np.abs(found[:, 4:]).max(axis=(1, 2)) > 1.0).mean() > 0.3  # many touch
    for column, k in enumerate(gaps):
        differences = []
        for step in (1e-6, 1e-7):
            ends = [model.predict(q, v, u, theta=theta + sign * step * np.eye(len(theta))[k]) for sign in (1, -1)]
            differences.append(
                np.hstack([getattr(ends[0], n) - getattr(ends[1], n) for n in ("q_next", "v_next")]) / (2 * step)
            )
        off = np.abs(np.array(differences) - found[:, :, column]).max(axis=2).min(axis=0)
        off /= 1.0 + np.abs(found[:, :, column]).max(axis=1)
        assert np.median(off) < 1e-6
        assert np.quantile(off, 0.9) < 1e-4  # but for kinks


def test_a_play_is_followed_along_a_log_that_does_not_tell_it(arm: Path) -> None:
    scene = played(arm)
    log, play = recorded(Path(scene.path).read_text(), 1500)
    wide = with_columns(log, scene)
    assert [joint.name for joint in unlogged(wide, scene)] == ["a_play", "b_play"]
    seen = like_mujoco(scene).seen(wide)
    assert np.abs(play).max() > 0.4 * GAP
    off = np.abs(seen.q[:, [1, 3]] - play)
    assert np.median(off) < 1e-3 * GAP
    assert np.quantile(off, 0.95) < 0.1 * GAP  # but for parts that begin in the middle
    np.testing.assert_array_equal(seen.q[:, [0, 2]], log.q)
    np.testing.assert_array_equal(seen.windows(20), log.windows(20))
    assert not unlogged(seen, scene)


def test_a_position_log_needs_no_column_of_a_play(arm: Path) -> None:
    scene = played(arm)
    log, _ = recorded(Path(scene.path).read_text(), 300)
    positions = PositionLog(
        time=0.01 * np.arange(300), position=log.q, command=log.u, joint_names=("a", "b"), command_kind="torque"
    )
    np.testing.assert_array_equal(positions.measured(scene), [True, False, True, False])
    wide = together({"log": positions}, scene)
    assert not wide.q[:, [1, 3]].any()
    evidence = Evidence.of(like_mujoco(scene), positions)
    assert evidence.log.q[:, [1, 3]].any()
    scales = evidence.scales(5, 0.5)[0]
    assert np.isinf(scales.q[[1, 3]]).all()
    assert set(scales.uncertain) >= {1, 3, 5, 7}


def test_a_fit_finds_the_gap_and_what_the_rotor_weighs(arm: Path) -> None:
    """The file without play takes the link's inertia for a rotor's."""
    truth = ARM.replace('armature=".01"', 'armature=".014"').replace('mass=".25"', 'mass=".35"')
    arm.with_name("true.xml").write_text(truth)
    log, _ = recorded(played_file(arm.with_name("true.xml"), {"a": GAP, "b": 0.5 * GAP}), 1500)
    log = replace(log, episode=np.arange(len(log)) // 150)
    model = like_mujoco(played(arm, 0.01))
    little = Budget().shrunk(0.2)
    found = cmbrl.fit(model, log, groups=["play", "armature", "mass"], horizon=10, budget=little)
    values = {name: (p.value, p.low, p.high) for name, p in found.parameters.items()}
    assert values["play.a"][0] == pytest.approx(GAP, rel=0.15)
    assert values["play.b"][0] == pytest.approx(0.5 * GAP, rel=0.15)
    assert values["armature.a"][1] < 0.014 < values["armature.a"][2]
    assert values["armature.a"][0] == pytest.approx(0.014, rel=0.05)
    assert values["mass.fore"][0] == pytest.approx(1.4, rel=0.05)


@pytest.mark.parametrize(
    ("errors", "taken"),
    [
        ((0.5, 0.2), {"a": GAP}),
        ((0.5, 0.49), {}),
        ((0.5, np.inf), {}),
        ((0.5, "refused"), {}),
        ((0.5, None), {}),
        (([0.01, 0.01, 0.5], [0.04, 0.04, 0.3]), {}),  # better in all, where one joint that stands still rules
        (([0.01, 0.01, 0.5], [0.01, 0.01, 0.3]), {"a": GAP}),
    ],
)
def test_play_is_taken_where_unseen_episodes_call_for_it(
    errors: tuple[Any, Any], taken: dict[str, float], arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit that shows play is compared with one of the file with it, if one can be made."""
    fits = []

    def told(model: ComplementarityModel, log: object, **options: object) -> FitResult:
        fits.append(options)
        if errors[len(fits) - 1] == "refused":
            raise UserError("no fit of this file")
        gaps = {} if errors[1] is None or len(fits) > 1 else {"a": GAP}
        rows = [{"steps": steps, "by_channel": np.atleast_1d(errors[len(fits) - 1])} for steps in (1, 5)]
        about = {"stopped": None, "seconds": {"total": 1.0}}
        return FitResult(model, {}, {"gaps": gaps, "horizons": rows, **about})

    monkeypatch.setattr("cmbrl.fitting.played.fit", told)
    model = like_mujoco(Scene.from_mjcf(arm)).with_settings(observation={"delay.command": 0.01})
    found = fit_or_played(model, None, seed=7)  # type: ignore[arg-type]
    assert gaps_of(found.model.scene) == pytest.approx(taken)
    assert [options["seed"] for options in fits] == [7] * (1 if errors[1] is None else 2)
    assert found.report.get("with_play", {}).get("taken", False) == bool(taken)
    assert found.model.observation == model.observation
    assert found.model.dt == model.dt


@pytest.mark.parametrize(("error", "taken"), [(0.2, True), (0.49, False)])
def test_an_interrupted_fit_with_play_is_told(
    error: float, taken: bool, arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it is not taken, nothing is said of what it leaves: it may be taken once it has gone on."""
    begun: list[object] = []

    def told(model: ComplementarityModel, log: object, **options: object) -> FitResult:
        begun.append(options["folder"])
        first = len(begun) == 1
        rows = [{"steps": 1, "by_channel": [0.5 if first else error]}]
        about = {"stopped": None if first else "interrupted", "seconds": {"total": 1.0}}
        return FitResult(model, {}, {"gaps": {"a": GAP} if first else {}, "horizons": rows, **about})

    monkeypatch.setattr("cmbrl.fitting.played.fit", told)
    found = fit_or_played(like_mujoco(Scene.from_mjcf(arm)), None, folder=arm.parent)  # type: ignore[arg-type]
    assert begun == [arm.parent, arm.parent / "with_play"]
    assert found.report["stopped"] == "interrupted"
    assert ("with_play" in found.report) == bool(gaps_of(found.model.scene)) == taken


def test_a_fit_with_play_of_its_own_is_compared_on_the_file_of_the_robot(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, _ = recorded(played_file(arm, {"a": GAP, "b": GAP}), 400)
    log = replace(log, episode=np.arange(len(log)) // 100)
    log.save(tmp_path / "log.npz")
    scene = Scene.from_mjcf(arm)
    model = like_mujoco(scene)
    alone = cmbrl.fit(model, log, groups=["armature"], horizon=4, holdout=0.0)
    found = cmbrl.fit(with_play(model, {"a": 0.6 * GAP, "b": GAP}), log, groups=["play"], horizon=4, holdout=0.0)
    for name, each in (("with", found), ("without", alone)):
        assert keep(each, scene, tmp_path / name) == tmp_path / name
    assert (tmp_path / "with" / "played.xml").is_file()
    words = [str(tmp_path / name) for name in ("with", "without")]
    for given in (words, words[::-1], [*words, "--scene", str(arm)]):
        assert main(["error", "nominal", *given, "--data", str(tmp_path / "log.npz"), "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)["entries"]
        error = {row["model"]: row["error"] for row in rows if (row["horizon"], row["stratum"]) == (5, "all")}
        assert error["with"] < 0.5 * error["without"] < error["nominal"]
        assert error["nominal"] == pytest.approx(_error_of_file(model, log), rel=0.02)  # without play
    assert (
        main(["error", *words, "--data", str(tmp_path / "log.npz"), "--open-loop", "--restart", "0.5", "--json"]) == 0
    )
    of = {
        name: each["mean_absolute_position_error"]
        for name, each in json.loads(capsys.readouterr().out)["models"].items()
    }
    assert of["with"] < 0.5 * of["without"]


def _error_of_file(model: ComplementarityModel, log: Transitions) -> float:
    table = compare({"file": model.with_settings(sliding="coulomb")}, log, model.scene, (5,))
    return next(entry.error for entry in table.entries if entry.stratum == "all")


@pytest.mark.slow
def test_a_fit_by_the_command_has_play_where_the_log_shows_it(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It resumes; ``--no-play`` and named groups fit the file alone."""
    log, _ = recorded(played_file(arm, {"a": GAP, "b": 0.5 * GAP}), 800)
    replace(log, episode=np.arange(len(log)) // 100).save(tmp_path / "log.npz")
    start = ["fit", str(arm), "--data", str(tmp_path / "log.npz"), "--threads", "2", "--all-parameters"]
    assert main([*start, "--horizon", "8", "--out", str(tmp_path / "fit")]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "So it was fitted with play at a, b, too (" in told
    kept = FitResult.load(tmp_path / "fit")
    assert kept.parameters["play.a"].value == pytest.approx(GAP, rel=0.15)
    assert kept.report["with_play"]["taken"]
    assert kept.report["with_play"]["error"] < BETTER
    (tmp_path / "fit" / "fit.json").unlink()
    assert main([*start, "--horizon", "8", "--out", str(tmp_path / "fit"), "--resume"]) == 0
    assert FitResult.load(tmp_path / "fit").parameters == kept.parameters
    for alone, options in (("no", ["--no-play"]), ("named", ["--groups", "armature"])):
        command = [each for each in start if each != "--all-parameters" or alone == "no"]
        assert main([*command, "--horizon", "8", "--out", str(tmp_path / alone), *options]) == 0
        assert not gaps_of(FitResult.load(tmp_path / alone).model.scene)
        assert "cmbrl convert FILE.xml" in capsys.readouterr().out


def test_once_play_shows_at_one_joint_it_is_tried_at_all_that_may_have_it(arm: Path) -> None:
    scene = Scene.from_mjcf(arm)
    assert gaps_to_try(scene, [{"joint": "b", "gap": 0.02, "explains": 0.2}]) == {"a": 0.02, "b": 0.02}
    assert gaps_to_try(scene, []) == {}
    slide = ARM.replace('name="a" axis="0 1 0"', 'name="a" type="slide" axis="0 1 0"').replace('armature=".005"', "")
    arm.write_text(slide)
    scene = Scene.from_mjcf(arm)
    assert gaps_to_try(scene, [{"joint": "a", "gap": 0.002, "explains": 0.2}]) == {"a": 0.002}  # b has no rotor


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--play", "c"], "no joint 'c'"),
        (["--play", "a=0"], "above 0"),
        (["--play", "a", "--hold", "b"], "one after the other"),
        (["--play", "a", "--floor"], "--play is of an MJCF"),
    ],
)
def test_play_that_cannot_be_is_refused(
    options: list[str], said: str, arm: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = arm.with_name("out.xml")
    assert main(["convert", str(arm), str(out), *options]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_a_joint_has_play_once_and_a_ball_none(arm: Path) -> None:
    scene = played(arm)
    with pytest.raises(UserError, match="has play already, 'a_play'"):
        played_file(scene.path, {"a": None})
    arm.write_text(
        "<mujoco><worldbody><body><joint name='turn' type='ball'/><geom size='.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(UserError, match="'turn' is no hinge or slide"):
        played_file(arm, {"turn": None})


@pytest.mark.parametrize(
    ("joints", "why"),
    [
        ({"c": None}, r"arm\.xml: no joint 'c'; known: a, b"),
        ({"a": -1.0}, r"^--play a=-1: give the gap"),
        ({"b": None}, r"arm\.xml: joint 'b' has no armature"),
    ],
)
def test_what_cannot_have_play_is_told(arm: Path, joints: dict[str, float | None], why: str) -> None:
    model = mujoco.MjSpec.from_file(str(arm))
    model.joint("b").armature = 0.0
    arm.write_text(model.to_xml())
    with pytest.raises(UserError, match=why):
        played_file(arm, joints)
