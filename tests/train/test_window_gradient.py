"""A window's gradient is the one that plain autograd finds: torch's layers, every message cut by torch's operations."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor, nn

import cmbrl
from cmbrl.gradients import derivative_model
from cmbrl.registry import load_task
from cmbrl.train import shac
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.windows.lost_gradients import LostGradients

pytest.importorskip("gymnasium", reason="the hopper's MJCF is Gymnasium's")
CONFIG = SHACConfig(environments=16, horizon=24, episode_steps=40, log_std_start=1.0, tame=1.5, clip=float("inf"))


class PlainTamed(torch.autograd.Function):
    """As :class:`cmbrl.train.shac.Tamed`, by torch's operations."""

    @staticmethod
    def forward(ctx: Any, q: Tensor, v: Tensor, factor: float, lost: LostGradients) -> Any:  # type: ignore[override]
        ctx.factor = factor
        return q.view_as(q), v.view_as(v)

    @staticmethod
    def backward(ctx: Any, gq: Tensor, gv: Tensor) -> Any:  # type: ignore[override]
        rows = torch.cat([gq, gv], dim=1)
        length = rows.norm(dim=1)
        usable = length.isfinite()
        rows, length = rows.nan_to_num(0.0, 0.0, 0.0), torch.where(usable, length, torch.nan)
        share = (ctx.factor * length.nanmedian() / length).clamp(max=1.0).nan_to_num(nan=0.0)[:, None]
        return *(rows * share).split([gq.shape[1], gv.shape[1]], dim=1), None, None


@pytest.mark.parametrize(
    "lengths", [[1.0, 2.0, 3.0, 100.0], [1.0, torch.nan, torch.inf, 9.0], 3 * [torch.nan], [0.0, 0.0, 1.0]]
)
@pytest.mark.parametrize("factor", [1.5, 1e9])
def test_messages_are_cut_as_by_torch(lengths: list[float], factor: float) -> None:
    torch.manual_seed(0)
    message = torch.randn(len(lengths), 5, dtype=torch.float64) * torch.tensor(lengths, dtype=torch.float64)[:, None]
    found = []
    for tamed in (shac.Tamed, PlainTamed):
        q, v = (torch.zeros(len(lengths), n, dtype=torch.float64, requires_grad=True) for n in (2, 3))
        torch.autograd.backward(tamed.apply(q, v, factor, LostGradients()), message.split([2, 3], dim=1))
        found.append(torch.cat([q.grad, v.grad], dim=1))
    torch.testing.assert_close(*found, rtol=1e-12, atol=0)


@pytest.mark.parametrize("derivative", ["exact", "abs", "gaussian", "bundle", "bcg"])
def test_a_window_s_gradient(derivative: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With episodes that end inside the window, noise, cuts, and the critic's value of what is not seen."""
    task = load_task("hopper")
    options = {"bundle": {"samples": 2}, "bcg": {"trigger": 1.0, "branches": 2}}.get(derivative, {})
    found = []
    for plain in (False, True):
        model = cmbrl.ComplementarityModel(task.load_scene(), smoothing=cmbrl.Barrier(1e-4), **task.model_options())
        trainer = SHAC(task.mdp(), derivative_model(model, derivative, **options), CONFIG, seed=3)
        assert trainer.critic is not None
        trainer.critic.units.deviation = torch.tensor(100.0)  # until the first window is learned, values are 0
        if plain:
            trainer.policy.net, trainer.critic.target = (
                nn.Sequential(*net) for net in (trainer.policy.net, trainer.critic.target)
            )
            monkeypatch.setattr(shac, "Tamed", PlainTamed)
        steps = trainer.roll(0.0)
        assert any(step.terminated.any() for step in steps[:-1])
        assert any(step.truncated.any() for step in steps[:-1])
        trainer.loss(steps).backward()
        found.append(torch.cat([p.grad.flatten() for p in trainer.policy.net.parameters()]))
    # Nets are float32: round-off in actions moves the states of the whole window.
    assert float((found[0] - found[1]).norm()) < 1e-4 * float(found[1].norm())
