"""The throws: descents that only the gradient's kind tells apart, fits, and a study that draws what it kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.bench.studies.throws import study
from cmbrl.bench.studies.throws.cells import QUICK, plan, process
from cmbrl.bench.studies.throws.contenders import CONTENDERS, THROWS
from cmbrl.bench.studies.throws.descent import Range, Rule, centred, real_distances
from cmbrl.bench.studies.throws.models import TASKS, fits, fitted, hard_model, known
from cmbrl.bench.studies.throws.summary import claims_table, verdict
from cmbrl.bench.study import Settings

TINY = replace(
    QUICK, tasks=("ball_slide",), contenders=("ABS 1 cm", "BS 1e-2 J", "FOPG", "ZOPG"), rule=Rule(iterations=2),
    candidates=16, mission_starts=1, mission=Rule(iterations=1), lengths=(5, 10), points=2, samples=2, judged=2,
    real_starts=1,
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


@pytest.mark.parametrize("name", [name for name in CONTENDERS if name != "FOPG"])
def test_every_estimator_finds_the_slope_of_a_slide_that_is_smooth(slide: Range, name: str) -> None:
    """Where the ball stops before the wall, all means agree with a central difference, over the ripples of 1 ms steps.

    They make a tenth of the slope.
    """
    contender, x, eps = CONTENDERS[name], np.array([[-0.5, 0.5]]), 0.02
    rng, generator = np.random.default_rng(1), torch.Generator().manual_seed(1)
    soft = slide.model.with_settings(backward_smoothing=contender.smoothing)
    count = 400 * THROWS[contender.order]
    (found,) = contender.estimates(lambda n: slide.throw(soft, n, rng, generator), x, count, 0.02, rng)
    sides = [[slide.returns(x + sign * eps * axis, 1, 0)[0] for sign in (1, -1)] for axis in np.eye(2)]
    slope = np.array([(up - down) / (2 * eps) for up, down in sides])
    assert np.linalg.norm(found.mean - slope) < 4 * found.standard_error + 0.1 * np.linalg.norm(slope)


def test_descent_by_the_hard_derivative_comes_nearer(slide: Range) -> None:
    path = slide.descend(CONTENDERS["FOPG"], np.array([[-0.5, 0.5]]), Rule(iterations=20), seed=0)
    distances = slide.distances(path)
    assert distances[-1, 0] < 0.5 * distances[0, 0]


def test_a_fit_finds_the_friction_that_ten_throws_show() -> None:
    (found,) = fits("ball_slide", (10,), draws=4, seed=0)
    names = [p.name for p in hard_model("ball_slide").scene.parameters]
    k = names.index("friction.ball")
    assert found["theta"][k] == pytest.approx(known("ball_slide")[k], rel=0.05)
    assert fitted(found).draws.shape == (4, len(names))
    outcome = plan("ball_slide", fitted(found), 0, TINY)
    assert 0 <= outcome["real"] < 3


def test_claims_are_judged_by_share_then_median() -> None:
    def run(name: str, *last: float) -> dict[str, object]:
        return {"task": "t", "scene": "known scene", "contender": name, "model": [[1.0, 1.0], list(last)]}

    cells = [run("ABS 1 cm", 0.01, 0.02), run("BS 1e-2 J", 0.01, 0.9), run("FOPG", 0.5, 0.5), run("ZOPG", 0.04, 0.03)]
    rows = {row[2]: row for row in claims_table(cells).rows}
    assert rows["ABS beats BS"][3:8] == ["repeats", "ABS 1 cm", "BS 1e-2 J", 1.0, 0.5]
    assert rows["ABS beats BS"][8:] == [0.5, 0.0]  # of the pairs, one is equal
    assert rows["BS beats zeroth order"][3] == "does not"
    assert "'BS beats FOPG' repeats in 1 of 1 scenes" in verdict(cells)


def test_the_study_draws_and_goes_on_from_what_it_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = Settings(quick=True, scenes=("ball_slide",))
    monkeypatch.setattr(study, "QUICK", replace(TINY, tasks=tuple(TASKS)))
    section = study.STUDY.run(tmp_path, settings, lambda *_: None)
    assert all((tmp_path / figure.file).stat().st_size > 5000 for figure in section.figures)
    assert [len(table.rows) for table in section.tables] == [8, 1, 8, 4]
    monkeypatch.setattr("cmbrl.bench.studies.throws.cells.fits", None)  # would fail if it were called again
    assert study.STUDY.run(tmp_path, settings, lambda *_: None).text == section.text
