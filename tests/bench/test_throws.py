"""The throws: descents that only the gradient's kind tells apart, fits, and a study that draws what it kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.bench.studies.throws import plots, study
from cmbrl.bench.studies.throws.arms import ARMS, FAMILIES
from cmbrl.bench.studies.throws.cells import QUICK, TASKS, Planning, fits, hard_model, known, plan, process
from cmbrl.bench.studies.throws.descent import Range, Rule, Sampler, centred, real_distances
from cmbrl.bench.studies.throws.tables import claims_table, verdict
from cmbrl.bench.study import Settings
from cmbrl.jobs import Runner

TINY = replace(
    QUICK, tasks=("ball_slide",), rule=Rule(iterations=2), lengths=(5, 10), points=2, samples=2,
    planning=Planning(Rule(iterations=1), candidates=16, starts=1, judged=2, real_starts=1),
)  # fmt: skip


@pytest.fixture(scope="module")
def slide() -> Range:
    mdp, _ = process("ball_slide")
    return Range(centred(mdp), hard_model("ball_slide"), known("ball_slide")[None, None])


def test_starts_of_a_centred_process_are_the_middle() -> None:
    mdp, _ = process("ball_throw")
    drawn = mdp.reset(20_000, torch.Generator().manual_seed(3))
    for middle, x in zip(centred(mdp).reset(2, torch.Generator()), drawn, strict=True):
        torch.testing.assert_close(middle[0], x.mean(dim=0), rtol=0, atol=0.01)


@pytest.mark.parametrize("task", TASKS)
def test_a_throw_of_the_known_scene_ends_where_the_real_one_does(task: str) -> None:
    """Within 5 cm at most decisions; one that grazes an edge may part, so of many the median is asked."""
    mdp, system = process(task)
    decisions = np.random.default_rng(0).uniform(-1, 1, (20, mdp.actions))
    place = Range(centred(mdp), hard_model(task), np.tile(known(task), (20, 1, 1)))
    gap = np.abs(place.distances(decisions[None])[0] - real_distances(centred(mdp), system, decisions))
    assert np.median(gap) < 0.05


BIASED = ("Gaussian 10 cm", "BS 1 J")  # so soft that walls at a distance brake the ball in the derivative


@pytest.mark.parametrize("name", [name for name in ARMS if name not in ("FOPG", *BIASED)])
def test_every_estimator_finds_the_slope_of_a_slide_that_is_smooth(slide: Range, name: str) -> None:
    """Where the ball stops before the wall, all means agree with a central difference, over the ripples of 1 ms steps.

    They make a tenth of the slope.
    """
    x, eps = np.array([[-0.5, 0.5]]), 0.02
    (found,) = Sampler(slide, ARMS[name], seed=1)(x, 400 * ARMS[name].throws, 0.02)
    sides = [[slide.returns(x + sign * eps * axis, 1, 0)[0] for sign in (1, -1)] for axis in np.eye(2)]
    slope = np.array([(up - down) / (2 * eps) for up, down in sides])
    assert np.linalg.norm(found.mean - slope) < 4 * found.standard_error + 0.1 * np.linalg.norm(slope)


def test_descent_by_the_hard_derivative_comes_nearer(slide: Range) -> None:
    path = slide.descend(ARMS["FOPG"], np.array([[-0.5, 0.5]]), Rule(iterations=20), seed=0)
    distances = slide.distances(path)
    assert distances[-1, 0] < 0.5 * distances[0, 0]


@pytest.mark.slow
def test_a_fit_finds_the_friction_that_ten_throws_show() -> None:
    (found,) = fits("ball_slide", (10,), draws=4, seed=0)
    names = [p.name for p in hard_model("ball_slide").scene.parameters]
    k = names.index("friction.ball")
    assert found["theta"][k] == pytest.approx(known("ball_slide")[k], rel=0.05)
    assert found["draws"].shape == (4, len(names))
    outcome = plan("ball_slide", 0, 10, found, TINY.planning)
    assert 0 <= outcome["real"] < 3


def test_claims_are_judged_by_share_then_median() -> None:
    def run(name: str, *last: float) -> dict[str, object]:
        return {"task": "t", "scene": "known scene", "arm": name, "model": [[1.0, 1.0], list(last)]}

    cells = [
        run("Gaussian 1 cm", 0.01, 0.02),
        run("BS 1e-2 J", 0.01, 0.9),
        run("FOPG", 0.5, 0.5),
        run("ZOPG", 0.04, 0.03),
    ]
    rows = {row[2]: row for row in claims_table(cells).rows}
    assert rows["Gaussian beats BS"][3:8] == ["repeats", "Gaussian 1 cm", "BS 1e-2 J", 1.0, 0.5]
    assert rows["Gaussian beats BS"][8:] == [0.5, 0.0]  # of the pairs, one is equal
    assert rows["BS beats zeroth order"][3] == "does not"
    assert "'BS beats FOPG' repeats in 1 of 1 scenes" in verdict(cells)


@pytest.mark.slow
def test_the_study_draws_and_goes_on_from_what_it_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = {}
    monkeypatch.setattr(plots, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    settings, runner = Settings(quick=True, scenes=("ball_slide",)), Runner(tmp_path / "cells")
    monkeypatch.setattr(study, "QUICK", replace(TINY, tasks=tuple(TASKS)))
    section = study.STUDY.run(tmp_path, settings, runner)
    assert [len(table.rows) for table in section.tables] == [8, 1, 8, 4]
    assert list(drawn) == [figure.file for figure in section.figures]
    families = [axes.get_title() for axes in drawn["throws_variance.png"].axes]
    assert families == list(FAMILIES)
    median = drawn["throws_variance.png"].axes[-1].get_lines()[0]
    row = next(row for row in section.tables[3].rows if row[1] == "ZOPG")
    np.testing.assert_array_equal(median.get_xydata(), [[50, row[2]], [100, row[3]]])
    made = {file: file.stat().st_mtime_ns for file in runner.folder.iterdir()}
    assert study.STUDY.run(tmp_path, settings, runner).text == section.text
    assert made == {file: file.stat().st_mtime_ns for file in runner.folder.iterdir()}  # nothing is computed again
