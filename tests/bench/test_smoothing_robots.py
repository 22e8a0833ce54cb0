"""The study of smoothing on robots: what is softened, what a verdict takes, and that it resumes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbrl.bench.studies.smoothing.plan import CONSTANT, FAMILIES, GAUSSIAN, HARD, PUBLISHED, Arm
from cmbrl.bench.studies.smoothing_robots import plots, study
from cmbrl.bench.studies.smoothing_robots.cells import learner_of, simulated, trained
from cmbrl.bench.studies.smoothing_robots.plan import SCENES, Plan, Size, plan_of
from cmbrl.bench.studies.smoothing_robots.tables import gain, returns
from cmbrl.bench.study import Settings
from cmbrl.contact.smoothing import ABS, Gaussian, parse_smoothing
from cmbrl.gradients.kinds import parse_derivative
from cmbrl.jobs import Runner
from cmbrl.models.complementarity import ComplementarityModel

SCENE = "hopper_dojo fopg"


def test_softening_is_of_the_derivative_and_of_the_simulation_only_where_both_are_asked() -> None:
    half, whole = (learner_of(SCENE, Arm("abs:peak=1,reach=1e-1", both, 1e-3), 1, 0) for both in (False, True))
    hard = learner_of(SCENE, Arm("exact"), 1, 0)
    models = [learner.model for learner in (hard, half, whole)]
    assert all(isinstance(model, ComplementarityModel) for model in models)
    told = [(model.smoothing, model.backward_smoothing) for model in models]  # type: ignore[union-attr]
    assert told[0][0] == told[0][1] == told[1][0]
    assert told[1][1] == told[2][0] == told[2][1] == ABS(peak=1.0, reach=0.1)
    assert half.config.rate == half.rate == 1e-3
    assert learner_of("cheetah_dojo shac", Arm("exact"), 1, 0).config.tame == 1e9


def test_every_setting_is_one_that_training_takes() -> None:
    tried = Plan((SCENE,)).tried
    assert tuple(tried) == FAMILIES
    for arm in (arm for arms in tried.values() for arm in arms):
        parse_derivative(arm.softening)
        parse_smoothing(simulated(arm.softening))
    assert [len(tried[family]) for family in FAMILIES] == [1, 14, 16, 12]
    stopped = parse_smoothing(simulated("gaussian-stopped:length=1e-3"))
    assert stopped == Gaussian(1e-3, derivative="stop")
    assert not set(Plan((SCENE,)).choosing) & set(Plan((SCENE,)).seeds)


def test_a_seed_learns_the_same_beside_any_other_and_is_tried_without_softening() -> None:
    alone, beside = (trained(SCENE, Arm("exact", rate=2e-3), Size(2, 2), seeds, 2) for seeds in ((7,), (5, 7)))
    np.testing.assert_array_equal(alone["returns"][:, 0], beside["returns"][:, 1])
    assert alone["updates"].tolist() == [0, 1, 2]
    soft = trained(SCENE, Arm("barrier:kappa=1", True, 2e-3), Size(2, 2), (7,), 2)
    assert soft["returns"][0] == alone["returns"][0]  # not trained yet, and tried in the same scene
    assert soft["returns"][-1] != alone["returns"][-1]


@pytest.mark.parametrize(
    ("first", "second", "verdict"),
    [
        ([120.0, 130.0, 110.0], [100.0, 100.0, 100.0], "repeats"),
        ([101.0, 99.0, 102.0], [100.0, 100.0, 100.0], "refuted: equal"),
        ([80.0, 70.0, 60.0], [100.0, 100.0, 100.0], "refuted: worse"),
        ([180.0, 20.0, 100.0], [100.0, 100.0, 100.0], "open"),
        ([-3.0, -2.0, -9.0], [-1.0, -1.0, -1.0], "refuted: equal"),  # neither earns anything
    ],
)
def test_a_gain_is_a_share_of_what_the_better_arm_earns(first: list[float], second: list[float], verdict: str) -> None:
    a, b = ({"returns": [[0.0, 0.0, 0.0], values]} for values in (first, second))
    assert gain(a, b).verdict == verdict
    if verdict == "repeats":
        np.testing.assert_allclose(gain(a, b).by_seed, [20 / 120, 30 / 120, 10 / 120])


def test_a_policy_that_is_lost_counts_as_the_worst() -> None:
    np.testing.assert_array_equal(returns({"returns": [[1.0, 2.0], [5.0, np.nan]]}), [5.0, 1.0])


@pytest.mark.slow
def test_the_study_draws_every_seed_and_goes_on_from_what_it_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: dict[str, Any] = {}
    monkeypatch.setattr(plots, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    tiny = replace(plan_of(SCENE, quick=True), judged=Size(2, 2), seeds=(200, 201), longer=2)
    monkeypatch.setattr(study, "plan_of", lambda scene, quick: tiny)
    settings, runner = Settings(quick=True, scenes=(SCENE,)), Runner(tmp_path / "cells")
    section = study.STUDY.run(tmp_path, settings, runner)
    verdicts, judged, chosen, seeds = section.tables
    assert [len(verdicts.rows), len(judged.rows), len(chosen.rows), len(seeds.rows)] == [8, 8, 8, 4]
    assert {row[2] for row in judged.rows} == {HARD, CONSTANT, GAUSSIAN, PUBLISHED}
    top, bottom = drawn[study.FIGURE].axes
    assert len(top.get_lines()) == 4 * (len(tiny.seeds) + 1)
    dots = [len(points.get_offsets()) for points in bottom.collections if len(points.get_offsets()) > 1]
    assert dots == [len(tiny.seeds)] * 6
    assert runner.seeds == len(tiny.seeds)
    made = {file: file.stat().st_mtime_ns for file in runner.folder.iterdir()}
    assert study.STUDY.run(tmp_path, settings, runner).text == section.text
    assert made == {file: file.stat().st_mtime_ns for file in runner.folder.iterdir()}  # nothing is computed again
    assert tuple(SCENES) == study.STUDY.scenes
