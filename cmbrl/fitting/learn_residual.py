"""Training of a residual in front of a fit: first-order gradients through the contact model, judged on unseen blocks.

The net is trained on windows of the log through the steps of the physics, so that it learns what to push *before*
contact answers. One fold of the log's blocks says when to stop. Another, which neither training nor stopping saw, says
whether the net is worth having: if its errors do not fall there beyond their noise, the net stays at zero.

Physics with a learned residual: Ajay et al., "Augmenting Physical Simulators with Stochastic Neural Networks" (IROS
2018); before the contact solve, as here: Heiden et al., "NeuralSim" (ICRA 2021).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import huber_loss

from cmbrl.data.several import Logs, named_logs
from cmbrl.errors import UserError
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.result import FitResult
from cmbrl.fitting.search.folds import LEAST_GAIN, NOISE_FACTOR, fold_of_rows, paired_gain, windows_in_blocks
from cmbrl.models.residual import ResidualModel
from cmbrl.models.windows import blocks_of, thinned
from cmbrl.numbers import whole

HUBER = 0.5  # residual, in standard deviations of the change, from which errors count linearly: that of a fit
FOLDS = 5  # one judges, one stops, the others train
SHORTEST, LONGEST = 4, 20  # steps of a window: one hardly tells a push from noise, long ones are chaos
LIMIT = 1.0  # of an acceleration, in standard deviations of those of the log
BATCH, RATE, DECAY, CLIP = 64, 3e-3, 1e-3, 1.0  # windows of an update; of AdamW
CHECK, PATIENCE = 25, 12  # updates between looks at the fold that stops; looks without a gain before the end
LOOKED_AT, JUDGED = 256, 2048  # windows of a look, and of the judgement, at most


@dataclass(frozen=True)
class ResidualReport:
    """Mean losses of windows of ``horizon`` steps on the fold that judges, and whether the net was ``kept``.

    ``share`` by coordinate: root mean square of the push over that of the logged change of velocity.
    """

    horizon: int
    updates: int
    windows: int
    before: float
    after: float
    noise: float
    kept: bool
    share: dict[str, float] = field(default_factory=dict)

    def text(self) -> str:
        """What a user should know of it, largest pushes first."""
        told = (
            f"held-out error of {self.horizon} steps, {self.windows} windows: {self.before:.4g} by the fit alone, "
            f"{self.after:.4g} with the residual"
        )
        if not self.kept:
            return f"{told}: it does not help beyond noise ({self.noise:.2g}), and stays at zero"
        largest = sorted(self.share.items(), key=lambda item: -item[1])[:6]
        pushes = ", ".join(f"{name} {100 * x:.0f} %" for name, x in largest)
        return f"{told}\nlargest pushes, against the logged change of velocity: {pushes}"


def fit_residual(
    fitted: FitResult,
    data: Logs,
    seed: int = 0,
    horizon: int | None = None,
    hidden: Sequence[int] = (64, 64),
    updates: int = 1000,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[ResidualModel, ResidualReport]:
    """The model of ``fitted`` with a residual learned from ``data``, and what it is worth on unseen blocks of it.

    Args:
        fitted: the fit; its parameters stay as they are.
        data: logs as for :func:`cmbrl.fit`, best those of the fit.
        seed: of the folds, the initial weights and the batches.
        horizon: steps of a window; default: the fit's, from 4 to 20, and for a log of positions the fit's.
        hidden: widths of the net's hidden layers.
        updates: gradient steps at most.
        progress: called with (fraction done, current activity).

    Raises:
        UserError: for a log of another robot or time step, or one too short to hold two of its parts out.
    """
    seed, updates = whole(seed, "seed", least=0), whole(updates, "updates", least=1)
    joined = int(fitted.report.get("joined", 1))  # rows of its log that were a step of the fit; a net acts in each
    model = fitted.model.at(next(iter(named_logs(data).values())).dt) if joined > 1 else fitted.model
    evidence, fitted = Evidence.of(model, data), replace(fitted, model=model)
    own = joined * int(fitted.report["horizon"])
    steps = own if evidence.positions_only else min(max(own, SHORTEST), LONGEST)
    steps = steps if horizon is None else whole(horizon, "horizon", least=1)
    learner = _Learner(fitted, evidence, steps, seed, hidden)
    learner.train(updates, progress or (lambda done, text: None))
    return learner.model, learner.judge()


class _Learner:
    def __init__(self, fitted: FitResult, evidence: Evidence, horizon: int, seed: int, hidden: Sequence[int]) -> None:
        scene, log = evidence.model.scene, evidence.log
        if evidence.model.parameters.shape != fitted.model.parameters.shape:
            raise UserError("the log drives other joints than the log of the fit: give the same kind of log")
        seen = evidence.model.seen(log)
        self.horizon, self.names, self.updates = horizon, list(scene.coordinate_names), 0
        self.tensors = [torch.as_tensor(x) for x in (seen.q, seen.v, seen.u, seen.q_next, seen.v_next)]
        scales = evidence.scales(horizon, HUBER)[0]
        self.units = torch.as_tensor(np.concatenate([scales.q, scales.v]))
        self.starts = self._folds(log, seed)
        self.blocks = blocks_of(log)
        self.random = np.random.default_rng(seed)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.model = ResidualModel.fresh(fitted.model, hidden)
        self._standardise(np.unique(self.starts[2]))

    def _folds(self, log: Any, seed: int) -> list[np.ndarray]:
        """First rows of the windows that judge, that stop, and that train."""
        starts, fold = windows_in_blocks(log, self.horizon), fold_of_rows(log, FOLDS, seed)
        parts = [starts[fold[starts] == 0], starts[fold[starts] == 1], starts[fold[starts] > 1]]
        if not all(len(part) for part in parts):
            raise UserError(
                f"too few parts of the log have windows of {self.horizon} steps to learn from some and judge others: "
                "give a longer one, or a shorter --horizon"
            )
        return parts

    def _standardise(self, rows: np.ndarray) -> None:
        q, v, u, _, v_next = (x[rows] for x in self.tensors)
        net = self.model.net
        features = net.features(q, v, u)
        deviation = features.std(dim=0, correction=0)
        net.input_mean.copy_(features.mean(dim=0))
        net.input_scale.copy_(torch.where(deviation < 1e-9, 1.0, deviation))
        change = net.own_frame(q, v_next - v)
        net.limit.copy_(LIMIT * change.std(dim=0, correction=0).clamp(min=1e-9))

    def train(self, updates: int, progress: Callable[[float, str], None]) -> None:
        """Until ``updates`` are done, or the fold that stops has not gained for a while; keeps the best weights."""
        net, training, stopping = self.model.net, self.starts[2], thinned(self.starts[1], LOOKED_AT)
        optimiser = torch.optim.AdamW(net.layers.parameters(), RATE, weight_decay=DECAY)
        best, kept, stale = self._mean(stopping), copy.deepcopy(net.state_dict()), 0
        for k in range(updates):
            for group in optimiser.param_groups:
                group["lr"] = RATE * 0.5 * (1.0 + math.cos(math.pi * k / updates))
            rows = self.random.choice(training, min(BATCH, len(training)), replace=False)
            loss = self._losses(rows)
            optimiser.zero_grad()
            loss[torch.isfinite(loss)].mean().backward()
            norm = torch.nn.utils.clip_grad_norm_(net.layers.parameters(), CLIP)
            if torch.isfinite(norm):
                optimiser.step()
            self.updates = k + 1
            if self.updates % CHECK and self.updates < updates:
                continue
            error = self._mean(stopping)
            progress(self.updates / updates, f"held-out error {error:.4g}")
            stale = 0 if error < best else stale + 1
            if error < best:
                best, kept = error, copy.deepcopy(net.state_dict())
            if stale >= PATIENCE:
                break
        net.load_state_dict(kept)
        net.requires_grad_(False)

    def judge(self) -> ResidualReport:
        """What the net is worth on the fold that nothing saw; it is set to zero if that is nothing."""
        rows, net = thinned(self.starts[0], JUDGED), self.model.net
        after = self._unseen(rows)
        q, v, u, _, v_next = (x[np.unique(self.starts[2])] for x in self.tensors)
        with torch.no_grad():
            push = net(q, v, u).square().mean(dim=0).sqrt()
        learned = copy.deepcopy(net.state_dict())
        for parameter in net.layers[-1].parameters():
            parameter.zero_()
        before = self._unseen(rows)
        finite = np.isfinite(before) & np.isfinite(after)
        _, index = np.unique(self.blocks[rows], return_inverse=True)
        gain, noise = paired_gain(np.where(finite, before, 0.0), np.where(finite, after, 0.0), index)
        kept = bool(finite.all()) and gain > max(NOISE_FACTOR * noise, LEAST_GAIN * float(before.mean()))
        if kept:
            net.load_state_dict(learned)
        share = (push / (v_next - v).square().mean(dim=0).sqrt().clamp(min=1e-12)).tolist()
        return ResidualReport(
            self.horizon, self.updates, len(rows), float(before.mean()), float(after.mean()), noise, kept,
            dict(zip(self.names, share, strict=True)),
        )  # fmt: skip

    def _losses(self, rows: np.ndarray) -> Tensor:
        """Huber losses (B,) of windows from ``rows`` (B,), mean over steps, sum over coordinates."""
        q, v, u, q_next, v_next = self.tensors
        at, speed, total = q[rows], v[rows], torch.zeros(len(rows), dtype=torch.float64)
        difference = self.model.coordinates.difference
        for j in range(self.horizon):
            at, speed = self.model.step(at, speed, u[rows + j])
            error = torch.cat([difference(q_next[rows + j], at), speed - v_next[rows + j]], dim=1) / self.units
            total = total + huber_loss(error, torch.zeros_like(error), reduction="none", delta=HUBER).sum(dim=1)
        return total / self.horizon

    def _unseen(self, rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return self._losses(rows).numpy()

    def _mean(self, rows: np.ndarray) -> float:
        losses = self._unseen(rows)
        return float(losses.mean()) if np.isfinite(losses).all() else math.inf
