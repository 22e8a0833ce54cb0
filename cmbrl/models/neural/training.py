"""Training of the neural ensemble by maximum likelihood; held-out rows choose when to stop and which nets predict."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi
from typing import Any

import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.models.neural.config import EnsembleConfig
from cmbrl.models.neural.network import EnsembleNetwork

MIN_ROWS = 10
TINY = 1e-12  # a feature or target that varies less is constant


@dataclass(frozen=True)
class TrainingReport:
    """Summary of a training; the error is an RMSE in units of the targets' standard deviation."""

    rows: int  # trained on
    holdout_rows: int
    epochs: int
    updates: int  # gradient steps
    seconds: float
    holdout_error: float  # mean of the elites
    stopped: str  # by "updates", "patience", "max_seconds" or "interrupted"


class _Best:
    """The best weights of each net so far, by its held-out error."""

    def __init__(self, network: EnsembleNetwork, improvement: float) -> None:
        self.network, self.improvement = network, improvement
        self.layers = [*network.weights, *network.biases]
        self.copies = [p.detach().clone() for p in self.layers]
        self.error = torch.full((self.layers[0].shape[0],), torch.inf)  # (nets,) mean squared

    def update(self, error: Tensor) -> bool:
        """Keeps the nets that improved by the margin; returns whether any did."""
        better = error < self.error * (1 - self.improvement)
        for copy, parameter in zip(self.copies, self.layers, strict=True):
            copy[better] = parameter.detach()[better]
        self.error = torch.where(better, error, self.error)
        return bool(better.any())

    def restore(self) -> None:
        with torch.no_grad():
            for copy, parameter in zip(self.copies, self.layers, strict=True):
                parameter.copy_(copy)


def train(
    network: EnsembleNetwork,
    config: EnsembleConfig,
    inputs: Tensor,
    targets: Tensor,
    seed: int,
    progress: Callable[[float, str], None] | None,
    max_seconds: float | None,
    warm_start: bool,
    updates_asked: int | None = None,
) -> tuple[TrainingReport, Tensor]:
    """Trains ``network`` on inputs (N, n) and targets (N, 2 nv), float64; returns a report and the elite nets.

    The other arguments are those of `NeuralEnsemble.fit`. Raises UserError if there are too few rows.
    """
    if len(inputs) < MIN_ROWS:
        raise UserError(f"the log has {len(inputs)} transitions; the ensemble needs at least {MIN_ROWS}: record more")
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(len(inputs), generator=generator)
    held = min(int(config.holdout * len(inputs)), config.holdout_max)
    kept = order[held:]
    if warm_start:
        network.standardise_inputs(inputs[kept].mean(dim=0), _deviation(inputs[kept]))
    else:
        network.reset(generator, config.initial_gain)
        _set_scales(network, inputs[kept], targets[kept], config.normalise_targets)
    x = ((inputs - network.input_mean) / network.input_scale).float()
    y = ((targets - network.target_mean) / network.target_scale).float()
    unseen = x[order[:held]], y[order[:held]]
    course = _Course(config.patience, config.updates if updates_asked is None else updates_asked, max_seconds)
    best = _Best(network, config.improvement if course.total is None else 0.0)
    network.requires_grad_(True)
    try:
        _descend(network, config, x[kept], y[kept], unseen, generator, course, best, progress)
    except KeyboardInterrupt:
        course.stopped = "interrupted"
    best.restore()
    network.requires_grad_(False)
    elites = best.error.argsort()[: config.elites]
    with torch.no_grad():
        mean, _ = network(unseen[0].expand(config.elites, -1, -1), elites)
    error = (mean.mean(dim=0) - unseen[1]) * network.target_scale / _deviation(targets)
    held_out = float(error.square().mean().sqrt())
    told = course.epochs, course.updates, course.seconds(), held_out, course.stopped
    return TrainingReport(len(kept), held, *told), elites


def _descend(
    network: EnsembleNetwork,
    config: EnsembleConfig,
    inputs: Tensor,
    targets: Tensor,
    unseen: tuple[Tensor, Tensor],
    generator: torch.Generator,
    course: _Course,
    best: _Best,
    progress: Callable[[float, str], None] | None,
) -> None:
    """Gradient steps on standardised rows until the ``course`` ends; each epoch may improve the ``best`` weights."""
    shape = (config.nets, len(inputs))
    if config.bootstrap:
        rows = torch.randint(len(inputs), shape, generator=generator)
    else:
        rows = torch.arange(len(inputs)).expand(shape)
    optimiser = _optimiser(network, config.learning_rate, config.weight_decay)
    while not course.stopped:
        rows = torch.gather(rows, 1, torch.rand(shape, generator=generator).argsort(dim=1))
        for batch in rows.split(config.batch, dim=1):
            if (done := course.done()) >= 1:
                break
            if course.total is not None:
                for group in optimiser.param_groups:
                    group["lr"] = config.learning_rate * 0.5 * (1 + cos(pi * done))
            optimiser.zero_grad()
            network.loss(inputs[batch], targets[batch], config.variance_regulariser, config.beta).backward()
            optimiser.step()
            course.updates += 1
        course.end_epoch(best.update(_held_out_error(network, *unseen)))
        if progress is not None:
            error = float(best.error.sort().values[: config.elites].mean().sqrt())
            progress(min(course.done(), 1.0), f"epoch {course.epochs}, held-out error {error:.4f}")


class _Course:
    """How far a training is: by ``total`` updates, or (None) by epochs without a gain; and by seconds."""

    def __init__(self, patience: int, total: int | None, max_seconds: float | None) -> None:
        self.patience, self.total, self.max_seconds = patience, total, max_seconds
        self.start = time.perf_counter()
        self.updates = self.epochs = self.stale = 0
        self.stopped = ""  #: by what, at the end

    def seconds(self) -> float:
        return time.perf_counter() - self.start

    def done(self) -> float:
        """The share of the training that is over; 1 or more at its end."""
        share = self.stale / (self.patience + 1) if self.total is None else self.updates / self.total
        return share if self.max_seconds is None else max(share, self.seconds() / max(self.max_seconds, 1e-9))

    def end_epoch(self, better: bool) -> None:
        self.epochs, self.stale = self.epochs + 1, 0 if better else self.stale + 1
        if self.max_seconds is not None and self.seconds() >= self.max_seconds:
            self.stopped = "max_seconds"
        elif self.total is None and self.stale > self.patience:
            self.stopped = "patience"
        elif self.total is not None and self.updates >= self.total:
            self.stopped = "updates"


def _deviation(columns: Tensor) -> Tensor:
    """Standard deviation of every column; 1 for a constant column."""
    deviation = columns.std(dim=0, correction=0)
    return torch.where(deviation < TINY, torch.ones_like(deviation), deviation)


def _set_scales(network: EnsembleNetwork, inputs: Tensor, targets: Tensor, normalise_targets: bool) -> None:
    network.input_mean.copy_(inputs.mean(dim=0))
    network.input_scale.copy_(_deviation(inputs))
    network.target_mean.copy_(targets.mean(dim=0) if normalise_targets else torch.zeros_like(network.target_mean))
    network.target_scale.copy_(_deviation(targets) if normalise_targets else torch.ones_like(network.target_scale))


def _optimiser(network: EnsembleNetwork, rate: float, weight_decay: tuple[float, ...]) -> torch.optim.Adam:
    """Adam with an L2 term on the weights, layer by layer, but not on biases or variance bounds."""
    groups: list[dict[str, Any]] = [
        {"params": [weight], "weight_decay": decay} for weight, decay in zip(network.weights, weight_decay, strict=True)
    ]
    free = [*network.biases, network.max_log_variance, network.min_log_variance]
    return torch.optim.Adam([*groups, {"params": free}], lr=rate, fused=True)


@torch.no_grad()
def _held_out_error(network: EnsembleNetwork, inputs: Tensor, targets: Tensor) -> Tensor:
    """Mean squared error (nets,) of each net, in the network's target units."""
    mean, _ = network(inputs.expand(network.weights[0].shape[0], -1, -1))
    return (mean - targets).square().mean(dim=(1, 2))
