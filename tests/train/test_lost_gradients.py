"""Gradients that are not finite: an update goes on without a few, a run says where there are many, and why."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.train.fopg import FOPG, FOPGConfig
from cmbrl.train.running.run import TrainingRun
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.trainer import Diverged
from cmbrl.train.windows.lost_gradients import LostGradients, without_derivative

from . import slider


def rooted(x):
    """A root that has no derivative at negative x, though no value of it is taken there."""
    return torch.where(x > 0.0, x.sqrt(), 0.0)


def left_is_lost(q, v, action, q_next, v_next):
    return slider.reward(q, v, action, q_next, v_next) - 0.1 * rooted(q_next[:, 0] + 0.6)


def all_is_lost(q, v, action, q_next, v_next):
    return slider.reward(q, v, action, q_next, v_next) - rooted(q_next[:, 0] - 2.0)


def made(folder, kind=SHAC, updates=30, **changes):
    model = ComplementarityModel(slider.scene(folder), time_step=slider.DT, threads=1)
    config = (
        SHACConfig(iterations=updates, environments=16, horizon=8)
        if kind is SHAC
        else FOPGConfig(iterations=updates, samples=16, horizon=8)
    )
    return kind(replace(slider.mdp(), **changes), model, config, 0)


def test_an_update_goes_on_without_the_rows_that_are_lost_and_says_so(tmp_path):
    trainer = made(tmp_path, reward=left_is_lost)
    lost = [trainer.update()["lost_gradients"] for _ in range(30)]
    assert 0.01 < sum(lost) / 30 < 0.5
    assert trainer.lost.skipped == 0
    assert trainer.lost.share == pytest.approx(sum(lost) / 30, rel=0.2)
    assert "of gradients were not finite, and are left out" in trainer.gradients
    assert "no finite value or derivative of MDP.reward" in trainer.gradients
    other = made(tmp_path, reward=left_is_lost)
    other.restore(trainer.state())
    assert other.gradients == trainer.gradients


def test_an_observation_without_a_derivative_is_no_silence(tmp_path):
    blind = made(tmp_path, observe=lambda q, v: torch.cat([q + rooted(q - 9.0), v], dim=1))
    beyond = made(tmp_path, observe=lambda q, v: torch.cat([(q - 9.0).log(), v], dim=1))  # which has a finite slope
    for trainer in (blind, beyond):
        with pytest.raises(Diverged, match=r"no finite value or derivative of MDP.observe \(in up to 100 %"):
            for _ in range(20):
                trainer.update()


@pytest.mark.parametrize("kind", [SHAC, FOPG])
def test_a_reward_without_a_derivative_is_named(tmp_path, kind):
    trainer = made(tmp_path, kind, reward=all_is_lost)
    with pytest.raises(Diverged, match="11 gradients in a row were not finite: there is no finite value or der"):
        TrainingRun(trainer, tmp_path / "run", {"task": "slider"}).train(30)
    assert trainer.lost.skipped == 11
    assert (tmp_path / "run" / "diverged.npz").is_file()


def test_a_sound_run_says_nothing_and_a_result_says_what_there_is(tmp_path):
    sound, other = made(tmp_path, updates=3), made(tmp_path, updates=3, reward=left_is_lost)
    for trainer, says in ((sound, False), (other, True)):
        folder = tmp_path / str(says)
        TrainingRun(trainer, folder, {"task": "slider"}).train(3)
        assert ("lost_gradients\":" in (folder / "train.json").read_text().replace(" ", "")
                and "were not finite" in (folder / "train.json").read_text()) == says  # fmt: skip


def test_the_share_of_states_without_a_derivative():
    mdp = replace(slider.mdp(), reward=left_is_lost)
    q = torch.tensor([[-0.9], [0.0], [0.5], [float("nan")]], dtype=torch.float64)
    assert without_derivative(mdp, q, torch.zeros_like(q)) == {"reward": pytest.approx(1 / 3)}
    assert without_derivative(slider.mdp(), q, torch.zeros_like(q)) == {}
    assert LostGradients().told() == ""
