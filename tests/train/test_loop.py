"""The loop on a small scale: what it counts, what it keeps, and that it goes on where it stopped."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.registry import load_task
from cmbrl.train.loop import Loop, LoopConfig

pytest.importorskip("gymnasium", reason="the hopper's real system is Gymnasium's MJCF")
SMALL = LoopConfig(
    iterations=8, rounds=2, policies=2, transitions=120, more=60, environments=8, horizon=4, actor_hidden=(16,),
    critic_hidden=(16,), score_every=2, score_episodes=4, draws=8,
)  # fmt: skip


@pytest.fixture
def make_loop():
    task = load_task("hopper")
    model = cmbrl.ComplementarityModel(task.load_scene(), smoothing=cmbrl.Barrier(1e-4), **task.model_options())
    return lambda **extra: Loop(task.mdp(), model, SMALL, seed=3, system=task.system, **extra)


def test_rounds_policies_and_transitions_are_counted(make_loop):
    loop = make_loop()
    rows = [loop.update() for _ in range(SMALL.iterations)]
    assert [row["transitions"] for row in rows] == 4 * [120] + 4 * [180]
    assert ["score" in row for row in rows] == 4 * [False, True]
    assert loop.round == 2
    fitted = loop.model
    assert fitted is not None
    assert fitted.candidates.shape == (8, len(fitted.parameters))
    assert not np.allclose(fitted.parameters, loop.nominal.parameters)


def test_the_best_scored_snapshot_of_a_round_goes_on(make_loop):
    loop = make_loop()
    best = -np.inf
    for _ in range(4):
        best = max(best, loop.update().get("score", -np.inf))
        kept = loop.best
    assert loop.round == 1
    for name, value in loop.policy.state_dict().items():
        torch.testing.assert_close(value, kept["policy"][name], rtol=0, atol=0)
    assert best > 0


def test_a_given_log_counts_and_only_the_rest_is_recorded(make_loop):
    log = load_task("hopper").record(100, seed=5)
    loop = make_loop(data=log)
    assert loop.update()["transitions"] == 120
    assert loop.recording.transitions == 20


@pytest.mark.parametrize("stop", [1, 5])
def test_it_goes_on_bit_for_bit(make_loop, stop):
    through, stopped, resumed = make_loop(), make_loop(), make_loop()
    for _ in range(stop):
        through.update(), stopped.update()
    resumed.restore(stopped.state())
    for _ in range(2):
        a, b = through.update(), resumed.update()
        assert a == b
