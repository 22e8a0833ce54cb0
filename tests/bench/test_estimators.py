"""Estimators that learn policies: the learner against identities, cells that are kept, sections that draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.bench.studies.estimators import cells as known_cells
from cmbrl.bench.studies.estimators import study as known_scene
from cmbrl.bench.studies.estimators.cells import cell, nominal
from cmbrl.bench.studies.estimators.contenders import CONTENDERS
from cmbrl.bench.studies.estimators.learning import Learning
from cmbrl.bench.studies.estimators.probe import probe
from cmbrl.bench.studies.estimators.search import BatchedARS
from cmbrl.bench.studies.horizons import cells as horizon_cells
from cmbrl.bench.studies.horizons import study as horizons
from cmbrl.bench.studies.horizons.cells import NAMES, Ask
from cmbrl.bench.studies.horizons.situations import SITUATIONS
from cmbrl.bench.workers import compute
from cmbrl.train.baselines import ARSConfig
from cmbrl.train.fopg import FOPG

SMALL = Learning(samples=4, horizon=3, episode_steps=30)
WORK = known_cells.Work(
    seconds={"hopper": 0.02}, learning={"hopper": SMALL}, contenders=("ABS", "exact", "AoBG", "ARS", "SHAC"), seeds=1,
    marks=1, episodes=1, final_episodes=2, probe_updates=1, probe_samples=8,
)  # fmt: skip
TINY = horizon_cells.Work(
    horizons=(2, 3), samples=4, truth=8, learning=(2,), updates=1, batch=2, seeds=2, judged=3
)  # fmt: skip


def test_a_window_is_worth_its_rewards_and_the_value_of_its_end() -> None:
    mdp, hard = nominal("hopper")
    learner = FOPG(mdp, hard, SMALL.fopg("pathwise"), seed=0)
    window = learner.roll(learner.simulation)
    steps = window.steps
    assert not any(bool((s.terminated | s.truncated).any()) for s in steps)
    rewards = sum(SMALL.discount**k * (s.reward + s.shaping) for k, s in enumerate(steps))
    assert learner.critic is not None
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
    situation = SITUATIONS["stiff"]
    policy, model = situation.policy(), situation.model()
    x = situation.start(policy.size, 0)[None]
    found = {}
    for name in ("exact", "zeroth", "AoBG"):
        (found[name],) = Ask(name, situation, 2).groups(x, 400, 0, CONTENDERS[name].model(model, 0), policy)
    exact = found["exact"].mean
    for name in ("zeroth", "AoBG"):
        error = np.linalg.norm(found[name].mean - exact)
        assert error < 4 * (found[name].standard_error + found["exact"].standard_error), name


def test_groups_are_the_policies_own() -> None:
    situation = SITUATIONS["soft"]
    policy, model = situation.policy(), situation.model()
    x = np.stack([situation.start(policy.size, k) for k in (0, 1)])
    both = Ask("exact", situation, 2).groups(x, 3, 5, model, policy)
    assert [e.gradients.shape for e in both] == [(3, policy.size)] * 2
    again = Ask("exact", situation, 2).groups(x, 3, 5, model, policy)
    assert np.array_equal(both[1].gradients, again[1].gradients)


def test_known_scene_is_kept_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = [(tmp_path, "hopper", name, 0, WORK) for name in WORK.contenders]
    outcomes = compute(cell, jobs, 1, lambda k: None)
    assert all(len(o["returns"]) == 2 and o["curve"][0]["updates"] == 0 and o["updates"] > 0 for o in outcomes)
    assert all(o["curve"][-1]["steps"] > 0 for o in outcomes)
    found = probe(tmp_path, "hopper", 0, WORK)
    assert set(found) == {"ABS", "exact", "AoBG"}
    assert abs(found["exact"]["true"]) > 0
    monkeypatch.setattr(known_cells, "train", None)  # cannot be called again
    assert compute(cell, jobs, 1, lambda k: None) == outcomes
    section = known_scene.section(outcomes, {"hopper": found}, tmp_path, WORK)
    assert all((tmp_path / figure.file).stat().st_size > 10_000 for figure in section.figures)
    assert len(section.tables[0].rows) == len(jobs)
    assert "adaptive smoothing learns best" in section.text
    section.write(tmp_path)


def test_horizons_are_kept_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = "soft"
    looks = [(tmp_path, place, h, name, 0, TINY) for h in TINY.horizons for name in NAMES]
    found = compute(horizon_cells.quality, looks, 1, lambda k: None)
    learned = compute(horizon_cells.learn, [(tmp_path, place, 2, n, 0, TINY) for n in NAMES], 1, lambda k: None)
    assert all(len(x["gains"]) == TINY.seeds and x["skipped"] == 0 for x in learned)
    monkeypatch.setattr(horizon_cells, "Ask", None)
    assert compute(horizon_cells.quality, looks, 1, lambda k: None) == found
    section = horizons.section(found, learned, tmp_path, TINY)
    assert all((tmp_path / figure.file).stat().st_size > 10_000 for figure in section.figures)
    assert len(section.tables[1].rows) == len(looks)
    section.write(tmp_path)


@pytest.mark.slow
def test_workers_give_what_one_process_gives(tmp_path: Path) -> None:
    jobs = [(2.0, k) for k in range(3)]
    assert compute(pow, jobs, 2, lambda k: None) == compute(pow, jobs, 1, lambda k: None)
