"""Estimators that learn policies: the learner against identities, pictures against tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from cmbrl.bench.studies.estimators import cells as known_cells
from cmbrl.bench.studies.estimators import plots as known_plots
from cmbrl.bench.studies.estimators import study as known_scene
from cmbrl.bench.studies.estimators.cells import Budget
from cmbrl.bench.studies.estimators.learning import Learning, nominal
from cmbrl.bench.studies.estimators.search import BatchedARS
from cmbrl.bench.studies.horizons import cells as horizon_cells
from cmbrl.bench.studies.horizons import plots as horizon_plots
from cmbrl.bench.studies.horizons import study as horizons
from cmbrl.bench.studies.horizons.cells import NAMES, gradients
from cmbrl.bench.studies.horizons.situations import SITUATIONS
from cmbrl.bench.study import Settings
from cmbrl.jobs import Runner
from cmbrl.train.ars import ARSConfig
from cmbrl.train.fopg import FOPG

SMALL = Learning(samples=4, horizon=3, episode_steps=30)
WORK = known_cells.Work(
    {"hopper": Budget(0.02, 1, 1, 2)}, {"hopper": SMALL}, ("Gaussian", "exact", "AoBG", "ARS", "SHAC"), seeds=2,
    probe_updates=1, probe_samples=8,
)  # fmt: skip
SHORT = horizon_cells.Training(1, batch=2, seeds=2, judged=3)
TINY = horizon_cells.Work((2, 3), samples=4, pairs=8, learning=(2,), training=SHORT)


def test_a_window_is_worth_its_rewards_and_the_value_of_its_end() -> None:
    mdp, hard = nominal("hopper")
    learner = FOPG(mdp, hard, SMALL.fopg("pathwise"), seed=0)
    assert learner.critic is not None
    learner.critic.units.deviation = torch.tensor(100.0)  # until the first window is learned, values are 0
    window = learner.roll(learner.simulation)
    steps = window.steps
    assert not any(bool((s.terminated | s.truncated).any()) for s in steps)
    rewards = sum(SMALL.discount**k * (s.reward + s.shaping) for k, s in enumerate(steps))
    value = learner.critic.value(steps[-1].next_observation.float()).double()
    assert torch.allclose(sum(window.rewards), rewards + SMALL.discount**SMALL.horizon * value)


def test_search_climbs_along_the_directions_that_paid() -> None:
    mdp, hard = nominal("hopper")
    search = BatchedARS(mdp, hard, ARSConfig(directions=2, best=2, rate=0.5, deviation=0.1), 5, seed=0)
    search._returns = lambda weights: weights[:, 0, 0].double()  # type: ignore[method-assign]
    before = search.layer.weight[0, 0].item()
    search.update()
    assert search.layer.weight[0, 0].item() > before


def test_first_and_zeroth_order_agree_where_nothing_touches() -> None:
    """Over one step in the air the return is smooth, so that both orders have the same mean."""
    x, found = SITUATIONS["stiff"].start(0)[None], {}
    for name in ("exact", "zeroth", "AoBG"):
        (found[name],) = gradients("stiff", 2, name, x, 400, 0)
    exact = found["exact"].mean
    for name in ("zeroth", "AoBG"):
        error = np.linalg.norm(found[name].mean - exact)
        assert error < 4 * (found[name].standard_error + found["exact"].standard_error), name


def test_groups_are_the_policies_own() -> None:
    x = np.stack([SITUATIONS["soft"].start(k) for k in (0, 1)])
    both = gradients("soft", 2, "exact", x, 3, 5)
    assert [e.gradients.shape for e in both] == [(3, x.shape[1])] * 2
    swapped = gradients("soft", 2, "exact", x[[0, 0]], 3, 5)
    assert np.array_equal(both[0].gradients, swapped[0].gradients)
    assert not np.allclose(both[1].gradients, swapped[1].gradients)


@pytest.mark.slow
def test_known_scene_is_drawn_as_the_tables_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[str, Figure] = {}
    monkeypatch.setattr(known_plots, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    monkeypatch.setattr(known_scene, "QUICK", WORK)
    section = known_scene.STUDY.run(tmp_path, Settings(quick=True, scenes=("hopper",)), Runner(tmp_path / "cells"))
    runs, found = section.values["runs"], section.values["gradients"]["hopper"]
    assert all(len(o["returns"]) == 2 and o["curve"][0]["updates"] == 0 and o["updates"] > 0 for o in runs)
    assert all(o["curve"][-1]["steps"] > 0 for o in runs)
    assert set(found) == {"Gaussian", "exact", "AoBG"}
    assert abs(found["exact"]["true"]) > 0
    assert list(drawn) == [figure.file for figure in section.figures]
    table = section.tables[0]
    medians = {row[1]: row[table.columns.index("median")] for row in table.rows}
    assert set(medians) == set(WORK.arms)
    ends = {line.get_label(): line.get_ydata()[-1] for axes in drawn["returns.png"].axes for line in axes.get_lines()}
    assert {name: ends[name] for name in medians} == pytest.approx(medians)
    assert "the Gaussian schedule learns best" in section.text


@pytest.mark.slow
def test_horizons_are_drawn_as_the_tables_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[str, Figure] = {}
    monkeypatch.setattr(horizon_plots, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    monkeypatch.setattr(horizons, "QUICK", TINY)
    section = horizons.STUDY.run(tmp_path, Settings(quick=True, scenes=("soft",)), Runner(tmp_path / "cells"))
    learning, gradients = section.tables
    assert list(drawn) == [figure.file for figure in section.figures]
    assert [len(table.rows) for table in section.tables] == [len(NAMES), 2 * len(NAMES)]
    assert all(row[5] is not None and row[-2] == 0 for row in learning.rows)  # a median, nothing skipped
    norms, _, cosines = drawn["horizon_gradients.png"].axes
    for axes, column in ((norms, 3), (cosines, 5)):
        for name in NAMES:
            (line,) = [line for line in axes.get_lines() if line.get_label() == name]
            assert list(line.get_ydata()) == [row[column] for row in gradients.rows if row[2] == name]
    assert all(x["cosine_range"][0] <= x["cosine_range"][1] for x in section.values["gradients"])
