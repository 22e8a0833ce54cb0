"""The library's algorithms as trainers: their actors as our policies, resume, learning, on a model and in reality."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cmbrl import ComplementarityModel, UserError
from cmbrl.envs.evaluation import evaluate_real
from cmbrl.train.ars import ARS, ARSConfig
from cmbrl.train.ppo import PPO, PPOConfig
from cmbrl.train.rivals.baseline import Baseline
from cmbrl.train.running.checkpoint import load_state, save_state
from cmbrl.train.sac import SAC, SACConfig

from . import slider

pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")

# A task that needs seconds, and the epochs and directions that suit it.
SMALL: dict[type[Baseline], Any] = {
    SAC: SACConfig(block=100, warmup=50, hidden=(24, 24), batch=40, rate=3e-3, discount=0.9, buffer=250),
    PPO: PPOConfig(
        environments=4, horizon=64, hidden=(24, 24), rate=3e-3, discount=0.9, log_std=-1.0, batch=64, epochs=5
    ),
    ARS: ARSConfig(environments=4, rate=0.3, deviation=0.2, best=4),
}
ALL = pytest.mark.parametrize("kind", [SAC, PPO, ARS])


def trainer(kind: type[Baseline], folder: Path, seed: int = 0, **changes: Any) -> Baseline:
    """In the real system."""
    return kind(slider.mdp(), slider.system(folder), replace(SMALL[kind], **changes), seed)


@ALL
def test_our_policy_acts_as_the_librarys_actor(kind: type[Baseline], tmp_path: Path) -> None:
    baseline = trainer(kind, tmp_path)
    for _ in range(2):
        baseline.update()
    observations = np.random.default_rng(0).normal(0, 2, (50, 2))
    seen = observations if baseline.scales is None else baseline.scales.normalize_obs(observations)
    expected, _ = baseline.algorithm.predict(seen, deterministic=True)
    got = baseline.policy(torch.from_numpy(observations).float())
    np.testing.assert_allclose(got.numpy(force=True), expected, atol=1e-5)
    assert np.abs(expected).max() <= 1
    assert np.ptp(expected) > 0


@ALL
def test_resumed_ends_at_the_same_bits(kind: type[Baseline], tmp_path: Path) -> None:
    straight = trainer(kind, tmp_path)
    for _ in range(3):  # SAC's buffer of 250 steps has begun to forget
        straight.update()
    save_state(tmp_path / "state.safetensors", straight.state())
    np.random.default_rng(0)
    torch.rand(3)  # global random numbers do not matter
    resumed = trainer(kind, tmp_path, seed=7)
    resumed.restore(load_state(tmp_path / "state.safetensors"))
    metrics = [baseline.update() for baseline in (straight, resumed)]
    assert metrics[0] == metrics[1]
    for name, value in straight.policy.state_dict().items():
        assert torch.equal(value, resumed.policy.state_dict()[name]), name


@ALL
def test_learns_better_than_doing_nothing(kind: type[Baseline], tmp_path: Path) -> None:
    baseline = trainer(kind, tmp_path)
    before = evaluate_real(lambda o: torch.zeros(len(o), 1), slider.mdp(), slider.system(tmp_path), 10).returns.mean()
    for _ in range(8):
        baseline.update()
    after = evaluate_real(baseline.policy, slider.mdp(), slider.system(tmp_path), 10).returns.mean()
    assert (after - before) / (20 - before) > 0.25  # of what there is to gain: at best 1 in each of 20 steps


def test_counts_steps_of_model_and_system_apart(tmp_path: Path) -> None:
    real = trainer(PPO, tmp_path).update()
    assert (real["transitions"], "steps" in real) == (256, False)
    model = ComplementarityModel(slider.scene(tmp_path), time_step=slider.DT)
    modelled = PPO(slider.mdp(), model, SMALL[PPO]).update()
    assert (modelled["steps"], "transitions" in modelled) == (256, False)
    # frictionless and unlimited, the model is the system: the same seed must meet the same episodes
    assert modelled["return"] == pytest.approx(real["return"], abs=1e-4)
    assert SACConfig().iterations * SACConfig().block == 1_000_000


def test_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    with pytest.raises(UserError, match=r"sb3_contrib .* pip install 'cmbrl\[train\]'"):
        trainer(ARS, tmp_path)
