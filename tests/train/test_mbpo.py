"""MBPO: its schedule, its rollouts, its batches, and that it learns, on real steps and on a log alone."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cmbrl import Transitions, UserError
from cmbrl.envs.evaluation import evaluate_real
from cmbrl.envs.recording import Recording
from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.registry import load_task
from cmbrl.train.mbpo import MBPO
from cmbrl.train.mbpo_config import MBPOConfig
from cmbrl.train.recipe import configure
from cmbrl.train.rivals.branching import branch
from cmbrl.train.rivals.pool import Mixture, Pool
from cmbrl.train.running.checkpoint import load_state, save_state
from cmbrl.train.running.run import TrainingRun

from . import slider

pytest.importorskip("stable_baselines3")

NET = EnsembleConfig(
    nets=3, elites=2, hidden=2, width=24, weight_decay=(0.0,) * 3, learning_rate=5e-3, updates=150, batch=64
)
SMALL = MBPOConfig(
    iterations=4, block=20, warmup=60, updates_per_step=2, rollouts=100, length_start=1, length_end=3, epoch_start=0,
    epoch_end=2, epoch=20, hidden=(24, 24), batch=40, rate=3e-3, discount=0.9, refit_updates=20,
)  # fmt: skip


def trainer(folder: Path, config: MBPOConfig = SMALL, seed: int = 0, **options: Any) -> MBPO:
    options = options or {"system": slider.system(folder)}
    return MBPO(slider.mdp(), NeuralEnsemble(slider.scene(folder), slider.DT, NET), config, seed, **options)


def logged(folder: Path, rows: int = 200) -> Transitions:
    """What random actions did in the real system."""
    recording = Recording(slider.mdp(), slider.system(folder), seed=5)
    draw = torch.Generator().manual_seed(5)
    for _ in range(rows):
        recording.step(2 * torch.rand(1, 1, generator=draw, dtype=torch.float64) - 1)
    return recording.log()


def test_rollouts_grow_as_published() -> None:
    lengths = {k: MBPOConfig().rollout_length(4 * k) for k in (0, 20, 85, 149, 150, 400)}  # 4 blocks an epoch
    assert lengths == {0: 1, 20: 1, 85: 8, 149: 14, 150: 15, 400: 15}
    assert {configure("mbpo", load_task("cheetah")).rollout_length(k) for k in (0, 700, 1579)} == {1}


def test_rollouts_may_jump_instead_of_growing() -> None:
    """epoch_end = epoch_start, or before it."""
    for end in (2, 1):
        config = MBPOConfig(block=1000, epoch_start=2, epoch_end=end, length_start=1, length_end=5)
        assert [config.rollout_length(k) for k in range(4)] == ([1, 1, 5, 5] if end == 2 else [1, 5, 5, 5])


class Jumps:
    """Moves every state by .3 [m], to nowhere from where v is 1."""

    name, dt = "jumps", slider.DT

    def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor, **_: Any) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.where(v == 1, torch.nan, q + 0.3), v


def test_rollouts_begin_where_told_and_never_cross_the_end() -> None:
    q = torch.tensor([[-0.5], [0.2], [0.5], [0.0]], dtype=torch.float64)
    v = torch.tensor([[0.0], [0.0], [0.0], [1.0]], dtype=torch.float64)
    steps = list(branch(slider.mdp(), Jumps(), lambda o: o[:, :1], q, v, 4, torch.Generator()))
    starts = [rows["q"][:, 0].tolist() for rows in steps]
    np.testing.assert_allclose(starts[0], [-0.5, 0.2, 0.5])  # the fourth row's prediction is not finite
    np.testing.assert_allclose(starts[1], [-0.2, 0.5, 0.8])
    np.testing.assert_allclose(starts[2], [0.1, 0.8])  # .8 + .3 lies beyond the end at 1
    np.testing.assert_allclose(starts[3], [0.4])
    assert [rows["terminated"].tolist() for rows in steps] == [[0, 0, 0], [0, 0, 1], [0, 1], [0]]
    for rows in steps:
        np.testing.assert_allclose(rows["next_observation"][:, 0], rows["observation"][:, 0] + 0.3)
        np.testing.assert_allclose(rows["reward"], 1 - rows["next_observation"][:, 0] ** 2)
    assert len(list(branch(slider.mdp(), Jumps(), lambda o: o[:, :1], q[2:3], v[2:3], 9, torch.Generator()))) == 2


def test_a_batch_is_5_percent_real() -> None:
    widths = {"observation": 2, "action": 1, "reward": 1, "next_observation": 2, "terminated": 1}
    real, imagined = Pool(widths, 50, torch.float64), Pool(widths, 50)
    for pool, mark in ((real, 1.0), (imagined, 2.0)):
        pool.add({name: torch.full((30, width), mark) for name, width in widths.items()})
    batch = Mixture(real, imagined, MBPOConfig().real_share, torch.Generator().manual_seed(0)).sample(256)
    assert [(batch.rewards == mark).sum().item() for mark in (1.0, 2.0)] == [12, 244]
    assert {x.dtype for x in batch if x is not None} == {torch.float32}
    assert [tuple(x.shape) for x in batch[:5]] == [(256, 2), (256, 1), (256, 2), (256, 1), (256, 1)]


def test_a_pool_forgets_the_oldest() -> None:
    pool = Pool({"x": 1}, 5)
    for start in (0, 3):
        pool.add({"x": torch.arange(start, start + 3.0)})
    assert pool.newest(9)[:, 0].tolist() == [1, 2, 3, 4, 5]
    again = Pool({"x": 1}, 1)
    again.restore(pool.state())
    assert torch.equal(again.rows, pool.rows)
    pool.resize(3)
    assert (pool.newest(9)[:, 0].tolist(), len(pool)) == ([3, 4, 5], 3)
    pool.add({"x": torch.arange(10.0)})
    assert sorted(pool.rows[:, 0].tolist()) == [7, 8, 9]


def test_imagined_steps_begin_in_logged_states(tmp_path: Path) -> None:
    data = logged(tmp_path)
    mbpo = trainer(tmp_path, replace(SMALL, length_end=1), data=data)
    mbpo.update()
    known = {tuple(row) for row in np.concatenate([data.q, data.v], axis=1).astype(np.float32).tolist()}
    began = mbpo.imagined.columns(mbpo.imagined.newest(10**6))["observation"]
    assert len(began) == SMALL.rollouts
    assert {tuple(row) for row in began.tolist()} <= known


def test_counts_real_and_imagined_steps(tmp_path: Path) -> None:
    mbpo = trainer(tmp_path)
    first, second = mbpo.update(), mbpo.update()
    assert (first["transitions"], second["transitions"]) == (80, 100)
    assert first["steps"] == 100  # rollouts of one step, then of two; some end early
    assert 100 < second["steps"] <= 300
    assert (first["rollout_length"], second["rollout_length"]) == (1, 2)
    log = mbpo.recording.log() if mbpo.recording else None
    assert log is not None
    again = slider.system(tmp_path)()
    for k in np.random.default_rng(0).choice(len(log), 10):
        again.reset(log.q[k], log.v[k])
        np.testing.assert_allclose(np.stack(again.step(log.u[k])), np.stack([log.q_next[k], log.v_next[k]]), atol=1e-12)
    np.testing.assert_allclose(log.v_next - log.v, slider.DT * slider.GEAR / slider.MASS * log.u, atol=1e-12)


@pytest.mark.parametrize("offline", [False, True])
def test_learns_better_than_doing_nothing(tmp_path: Path, offline: bool) -> None:
    config = replace(SMALL, iterations=8, updates_per_step=5)
    options = {"data": logged(tmp_path)} if offline else {"system": slider.system(tmp_path)}
    mbpo = trainer(tmp_path, config, **options)
    before = evaluate_real(lambda o: torch.zeros(len(o), 1), slider.mdp(), slider.system(tmp_path), 10).returns.mean()
    for _ in range(config.iterations):
        metrics = mbpo.update()
    after = evaluate_real(mbpo.policy, slider.mdp(), slider.system(tmp_path), 10).returns.mean()
    assert (after - before) / (20 - before) > 0.25  # of what there is to gain: at best 1 in each of 20 steps
    assert metrics["transitions"] == (200 if offline else 60 + 8 * 20)
    assert metrics["model_error"] < 0.3


def test_resumed_ends_at_the_same_bits(tmp_path: Path) -> None:
    straight = trainer(tmp_path)
    straight.update()
    save_state(tmp_path / "state.safetensors", straight.state())
    torch.rand(3)  # global random numbers do not matter
    resumed = trainer(tmp_path, seed=9)
    resumed.restore(load_state(tmp_path / "state.safetensors"))
    for mbpo in (straight, resumed):
        mbpo.update()
        mbpo.update()
    for name, value in straight.policy.state_dict().items():
        assert torch.equal(value, resumed.policy.state_dict()[name]), name
    assert torch.equal(straight.real.rows, resumed.real.rows)
    assert torch.equal(straight.imagined.rows, resumed.imagined.rows)


def test_a_log_without_actions_teaches_the_ensemble_alone(tmp_path: Path) -> None:
    halved = replace(slider.mdp(), act=lambda q, v, a: (q, v, a / 2))
    ensemble = NeuralEnsemble(slider.scene(tmp_path), slider.DT, NET)
    mbpo = MBPO(halved, ensemble, SMALL, data=logged(tmp_path, 20))
    before = mbpo.policy.net[0].weight.clone()
    with pytest.warns(UserWarning, match="no batch has rows of it"):
        metrics = mbpo.update()
    assert (len(mbpo.real), metrics["transitions"]) == (0, 20)
    assert len(mbpo.imagined) == metrics["steps"] > 0
    assert torch.isfinite(torch.tensor(metrics["model_error"]))
    assert not torch.equal(before, mbpo.policy.net[0].weight)


def test_stops_when_the_time_is_up(tmp_path: Path) -> None:
    mbpo = trainer(tmp_path, replace(SMALL, max_seconds=0.0))
    before = [p.clone() for p in mbpo.policy.parameters()]
    metrics = mbpo.update()
    assert mbpo.over
    assert (metrics["steps"], metrics["transitions"]) == (0, 0)
    assert all(torch.equal(a, b) for a, b in zip(before, mbpo.policy.parameters(), strict=True))
    assert not trainer(tmp_path, replace(SMALL, max_seconds=1e9)).over
    outcome = TrainingRun(mbpo, tmp_path / "run", about={}).train(iterations=100)
    assert (outcome.stopped, outcome.iteration) == ("finished", 0)


def test_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match="neither a real system nor a log"):
        trainer(tmp_path, SMALL, data=None)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(UserError, match=r"pip install 'cmbrl\[train\]'"):
        trainer(tmp_path)
