"""What a fit leaves and a change of its model would explain: play at a joint, and a finer time step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.choice.finer_steps import finer_steps, finer_told
from cmbrl.fitting.choice.play_shown import play_shown, shown_told
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.fitting.state import Journal
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.writing.played import played_file

from .played_arm import ARM, recorded

NONE = 1e-4  # rad: next to no play


def _fitted(folder: Path, gaps: dict[str, float]) -> cmbrl.FitResult:
    """Of an arm whose rotors weigh more than its file says, and that has play of ``gaps`` behind its motors."""
    true, file = folder / "true.xml", folder / "arm.xml"
    true.write_text(ARM.replace('armature=".01"', 'armature=".014"'))
    file.write_text(ARM)
    log, _ = recorded(played_file(true, gaps), 1200)
    log = replace(log, episode=np.arange(len(log)) // 150)
    model = ComplementarityModel(Scene.from_mjcf(file), 4, sliding="convex")
    return cmbrl.fit(model, log, groups=["mass", "armature", "damping"], horizon=4)


def test_play_that_the_file_lacks_is_named_with_the_command_that_tries_it(tmp_path: Path) -> None:
    found = _fitted(tmp_path, {"a": NONE, "b": 0.03})
    (play,) = found.report["play"]
    assert play["joint"] == "b"
    assert play["gap"] == pytest.approx(0.03, rel=0.7)
    assert play["explains"] > 0.3
    gap = f"{play['gap']:g}"
    assert f"convert FILE.xml played.xml --play a={gap} --play b={gap}`" in " ".join(found.report_text().split())


@pytest.mark.parametrize(
    ("tried", "told"),
    [
        (None, "convert FILE.xml played.xml --play a=0.02 --play b=0.02`"),
        ({"taken": False, "error": 0.97}, "leaves 0.97 of the error on unseen seconds, so that it was not taken."),
        ({"taken": False, "error": None}, "leaves no finite error on unseen seconds, so that it was not taken."),
        ({"taken": True, "error": 0.13}, "So it was fitted with play at a, b, too (9 s for both). That leaves 0.13 of"),
    ],
)
def test_a_report_tells_what_came_of_play(tried: dict[str, Any] | None, told: str) -> None:
    gaps = {"a": 0.02, "b": 0.02}
    report = {"play": [{"joint": "a", "gap": 0.02, "explains": 0.4}], "gaps": gaps}
    text = shown_told(report if tried is None else {**report, "with_play": {"gaps": gaps, "seconds": 9.0, **tried}})
    assert text is not None
    assert told in text
    assert ("--no-play" in text) == bool(tried and tried["taken"])


def test_nothing_is_said_of_play_where_there_is_none(tmp_path: Path) -> None:
    found = _fitted(tmp_path, {"a": NONE, "b": NONE})
    assert found.report["play"] == []
    assert shown_told(found.report) is None
    assert shown_told({}) is None


def test_a_file_that_has_play_is_not_tried_again(tmp_path: Path) -> None:
    file = tmp_path / "played.xml"
    (tmp_path / "arm.xml").write_text(ARM)
    file.write_text(played_file(tmp_path / "arm.xml", {"a": NONE, "b": 0.03}))
    log, _ = recorded(file.read_text(), 300)
    evidence = Evidence.of(ComplementarityModel(Scene.from_mjcf(file), 4), log)
    z = np.zeros(len(evidence.space))
    assert play_shown(evidence, z, np.ones(len(z), dtype=bool), 0.5, 0, Journal(None, "")) == []


def test_episodes_too_short_for_play_to_show_are_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    log, _ = recorded(played_file(file, {"a": NONE, "b": 0.03}), 300)
    log = replace(log, episode=np.arange(len(log)) // 5)
    model = ComplementarityModel(Scene.from_mjcf(file), 4, sliding="convex")
    assert cmbrl.fit(model, log, groups=["mass", "armature"], horizon=1).report["play"] == []


SERVOS = (
    '<position joint="a" kp="400" kv="40"/><position joint="b" kp="200" kv="20"/></actuator>',
    '<motor joint="a" ctrlrange="-2 2"/><motor joint="b" ctrlrange="-1 1"/></actuator>',
)


def _followed(folder: Path, step: float) -> tuple[Scene, PositionLog]:
    """The scene of stiff servos whose joints bear little, in steps of 2.5 ms, and a log of the same in ``step`` [s]."""
    text = ARM.replace(SERVOS[1], SERVOS[0]).replace("axis=", 'actuatorfrcrange="-3 3" axis=')
    (folder / "arm.xml").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = step
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    positions, targets = [], []
    for k in range(600):
        if k % 25 == 0:
            goal = draw.uniform(-0.5, 0.5, 2)
        data.ctrl[:] += 0.15 * (goal - data.ctrl)
        positions.append(data.qpos.copy())
        targets.append(data.ctrl.copy())
        mujoco.mj_step(model, data, nstep=round(0.01 / step))
    time, position, command = 0.01 * np.arange(600), np.array(positions), np.array(targets)
    log = PositionLog(time=time, position=position, command=command, joint_names=("a", "b"))
    return Scene.from_mjcf(folder / "arm.xml"), log


@pytest.mark.parametrize(("step", "finer"), [(2.5e-4, True), (2.5e-3, False)])
def test_steps_that_are_too_long_for_a_stiff_servo_show(step: float, finer: bool, tmp_path: Path) -> None:
    scene, log = _followed(tmp_path, step)
    evidence = Evidence.of(ComplementarityModel(scene), log)
    assert evidence.model.in_usual_steps()
    loss = evidence.loss(draw_starts(evidence.log, 20, 2000, 0), 20, *evidence.scales(20, 0.5))
    for active in (None, evidence.space.default):
        found = finer_steps(evidence, loss, np.zeros(len(evidence.space)), active)
        assert (found is not None) is finer
        if found:
            assert found["share"] in (2, 4)
            assert found["explains"] > 0.5


def test_a_fit_goes_on_in_finer_steps_and_says_so(tmp_path: Path) -> None:
    scene, log = _followed(tmp_path, 2.5e-4)
    found = cmbrl.fit(ComplementarityModel(scene), log, groups=["mass", "kp", "kd", "damping"])
    assert found.model.time_step < 2.5e-3
    assert found.model.dt == pytest.approx(0.01)
    assert not found.model.in_usual_steps()
    assert found.report["finer"]["time_step"] == found.model.time_step
    assert "The fit took time steps of" in found.report_text()
    kept = cmbrl.fit(
        ComplementarityModel(scene, 5, time_step=2e-3), log, groups=["mass", "kp", "kd", "damping"]
    )  # another step than the usual one was asked for
    assert kept.model.time_step == 2e-3
    assert kept.report["finer"] is None
    assert finer_told(kept.report) is None
    assert found.report["loss"]["all, fitted"]["loss"] < 0.6 * kept.report["loss"]["all, fitted"]["loss"]
