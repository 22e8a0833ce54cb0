"""The study of smoothing: what is softened, how settings are chosen, what a verdict takes, and that it resumes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbrl.bench.groups import POINT
from cmbrl.bench.studies.smoothing import plots, study
from cmbrl.bench.studies.smoothing.cells import descended, score
from cmbrl.bench.studies.smoothing.halving import best_of, chosen
from cmbrl.bench.studies.smoothing.plan import CONSTANT, FAMILIES, HARD, QUICK, Arm, Plan, Size
from cmbrl.bench.studies.smoothing.verdicts import DISTANCE, HITS, gain, measure_of
from cmbrl.bench.studies.throws.arms import Arm as Estimator
from cmbrl.bench.studies.throws.cells import hard_model
from cmbrl.bench.study import Settings
from cmbrl.contact.smoothing import ABS, Barrier, Exact, parse_smoothing
from cmbrl.jobs import Job, Runner

TINY = replace(QUICK, tasks=("ball_over",), judged=Size(4, launches=3), longer=4)


def test_softening_is_of_the_derivative_and_of_the_simulation_only_where_both_are_asked() -> None:
    model = hard_model("ball_over")
    half = Estimator("", "", (POINT,), Barrier(1.0)).soften(model)
    whole = Estimator("", "", (POINT,), Barrier(1.0), both=True).soften(model)
    q = np.array([[0.0, 0.105, 0.0]])
    step = {m: m.predict(q, np.zeros((1, 3)), np.zeros((1, 0))).v_next for m in (model, half, whole)}
    np.testing.assert_array_equal(step[half], step[model])
    assert step[whole][0, 1] > step[model][0, 1] + 0.05  # pushed away before it touches
    assert isinstance(model.smoothing, Exact)


def test_every_setting_is_one_that_the_command_takes() -> None:
    tried = Plan().tried
    assert tuple(tried) == FAMILIES
    for arms in tried.values():
        assert len({arm.label for arm in arms}) == len(arms)
        for arm in arms:
            parse_smoothing(arm.softening).resolve(hard_model("ball_throw").scene, 1e-3)
    assert [arm.softening for arm in tried[CONSTANT] if not arm.both][::9] == [
        "barrier:kappa=1e-6",
        "barrier:kappa=1e3",
    ]
    assert len([arm for arm in tried["published (ABS)"] if not arm.both]) == 14
    assert parse_smoothing(tried["published (ABS)"][0].softening) == ABS(peak=1e-6, reach=1e-2)
    assert not set(Plan().choosing) & set(Plan().seeds)


def test_a_seed_has_the_same_launches_beside_any_other() -> None:
    alone, beside = (descended("ball_over", Arm("exact"), Size(1, launches=3), seeds) for seeds in ((7,), (5, 7)))
    np.testing.assert_array_equal(alone["distances"][0, 0], beside["distances"][0, 1])
    soft = descended("ball_over", Arm("abs:peak=1,reach=1e-1", both=True), Size(1, launches=3), (7,))
    np.testing.assert_array_equal(soft["distances"][0], alone["distances"][0])  # judged in the hard scene
    assert not np.array_equal(soft["distances"][1], alone["distances"][1])


class Told:
    """In place of a runner: each launch ends ``miss`` of its arm from the goal."""

    def __init__(self, miss: dict[str, float]) -> None:
        self.miss, self.asked = miss, list[list[Arm]]()

    def run(self, jobs: Sequence[Job], what: str, share: tuple[float, float]) -> list[dict[str, Any]]:
        self.asked.append([job.inputs["arm"] for job in jobs])
        return [{"distances": [[[self.miss[arm.softening] / arm.rate]]]} for arm in self.asked[-1]]


def test_the_best_of_of_every_family_goes_on_and_rates_differ_on_the_last_rung() -> None:
    tried = {HARD: [Arm("a")], CONSTANT: [Arm(name) for name in "bcdefgh"]}
    told = Told({"a": 9.0, "b": 0.7, "c": 0.1, "d": 0.5, "e": 0.3, "f": 0.4, "g": 0.2, "h": 0.6})
    plan = Plan(tasks=("ball_over",), tried=tried, rungs=(Size(1), Size(2), Size(3)), keep=3, rates=(0.1, 0.3))
    found = chosen(plan, told, (0.0, 1.0), descended, score)["ball_over"]  # type: ignore[arg-type]
    assert [[arm.softening for arm in arms] for arms in told.asked] == [
        ["a", *"bcdefgh"],
        ["a", "c", "g", "e"],
        ["a", "a", "c", "c"],
    ]
    assert {arm.rate for arms in told.asked[:2] for arm in arms} == {0.1}
    assert found[CONSTANT][-1][0][0] == Arm("c", rate=0.3)
    assert len(best_of([(Arm("x"), (0.0, -1.0))], 3)) == 1


def test_hits_rank_before_distances() -> None:
    near, hit = {"distances": [[[0.06, 0.06]]]}, {"distances": [[[0.04, 5.0]]]}
    assert score(hit) > score(near)


@pytest.mark.parametrize(
    ("gained", "verdict"),
    [
        ([0.2, 0.3, 0.1, 0.2], "repeats"),
        ([0.02, -0.03, 0.0, 0.01], "refuted: equal"),
        ([0.03, 0.03, 0.03, 0.03], "refuted: equal"),
        ([-0.2, -0.3, -0.1, -0.2], "refuted: worse"),
        ([0.4, -0.3, 0.1, 0.0], "open"),
    ],
)
def test_a_verdict_is_that_of_the_interval(gained: list[float], verdict: str) -> None:
    """Hits by seed, 100 launches each: an arm less one that hits with half of them."""
    arms = {
        name: {"distances": [[np.where(np.arange(100) < 50 + 100 * gain, 0.01, 1.0) for gain in values]]}
        for name, values in (("first", np.array(gained)), ("second", np.zeros(4)))
    }
    found = gain(arms["first"], arms["second"], HITS)
    assert found.verdict == verdict
    assert found.mean == pytest.approx(np.mean(gained))
    assert found.low <= found.mean <= found.high
    assert measure_of(arms) == HITS


def test_where_none_hits_the_distance_decides_as_a_share_of_the_rivals() -> None:
    far, farther = {"distances": [[[1.0], [1.5]]]}, {"distances": [[[2.0], [3.0]]]}
    assert measure_of({"a": far, "b": farther}) == DISTANCE
    found = gain(far, farther, DISTANCE)
    np.testing.assert_allclose(found.by_seed, [1 / 2.5, 1.5 / 2.5])
    assert found.verdict == "repeats"


def test_the_study_draws_every_seed_and_goes_on_from_what_it_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: dict[str, Any] = {}
    monkeypatch.setattr(plots, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    monkeypatch.setattr(study, "QUICK", TINY)
    settings, runner = Settings(quick=True), Runner(tmp_path / "cells")
    section = study.STUDY.run(tmp_path, settings, runner)
    verdicts, judged, _, seeds = section.tables
    assert [len(verdicts.rows), len(judged.rows), len(seeds.rows)] == [8, 8, 6]
    assert {row[1] for row in judged.rows} == {"updates", "seconds"}
    assert all(row[4] in range(1, 5) for row in judged.rows if row[1] == "seconds")
    top, _, bottom = drawn[study.FIGURE].axes
    assert len(top.get_lines()) == 4 * (len(TINY.seeds) + 1)
    dots = [len(points.get_offsets()) for points in bottom.collections if len(points.get_offsets()) > 1]
    assert dots == [len(TINY.seeds)] * 6
    assert runner.seeds == len(TINY.seeds)
    made = {file: file.stat().st_mtime_ns for file in runner.folder.iterdir()}
    assert study.STUDY.run(tmp_path, settings, runner).text == section.text
    assert made == {file: file.stat().st_mtime_ns for file in runner.folder.iterdir()}  # nothing is computed again
