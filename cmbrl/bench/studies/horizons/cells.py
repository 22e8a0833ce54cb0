"""The jobs of the study: one situation, one horizon, one estimator; what its gradient is like, and whether one learns.

All estimators estimate the gradient of the same objective, which is smooth: the hard return, averaged over starts and
over normal noise of deviation ``STD`` on the policy's weights. First-order ones differentiate at noisy weights, zeroth
order takes differences of opposite noise, AoBG mixes both.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from cmbrl.bench.groups import FIRST, ZEROTH, estimates
from cmbrl.bench.studies.estimators.arms import ARMS, EXACT, GAUSSIAN
from cmbrl.bench.studies.horizons.situations import SITUATIONS, Situation
from cmbrl.gradients import Estimate, Rollout
from cmbrl.gradients.estimate import Array
from cmbrl.gradients.kinds import DerivativeModel

STD = 0.05  #: of the noise on weights
HELD_OUT = 10_000_000  #: seed of the starts on which learners are judged
RESAMPLES = 400  #: of the bootstrap
NAMES = (EXACT, "BS 1e-4", GAUSSIAN, "bundle", "BCG", "zeroth", "AoBG")
ORDERS = {"pathwise": (FIRST,), "zeroth": (ZEROTH,), "aobg": (FIRST, ZEROTH)}  #: by an arm's estimator
Outcome = dict[str, Any]


@dataclass(frozen=True)
class Training:
    """A short training."""

    updates: int = 30
    batch: int = 8  #: episodes of an update
    rate: float = 0.05  #: of Adam, in weights
    seeds: int = 3  #: first policies, trained side by side
    judged: int = 32  #: episodes on which a policy is judged


@dataclass(frozen=True)
class Work:
    """Sizes of the study."""

    horizons: tuple[int, ...] = (32, 64, 128, 256, 512)
    samples: int = 64  #: of every gradient
    pairs: int = 2048  #: of the zeroth-order reference
    learning: tuple[int, ...] = (32, 128, 512)  #: horizons of the trainings
    training: Training = field(default_factory=Training)


QUICK = Work((8, 32), samples=16, pairs=64, learning=(8, 32), training=Training(3, batch=4, seeds=2, judged=8))


def gradients(
    place: str, horizon: int, arm: str, x: Array, rows: int, seed: int, model: DerivativeModel | None = None
) -> list[Estimate]:
    """One estimate by ``arm`` from ``rows`` episodes for each of the policies x (G, n); ``model`` spares making it."""
    situation = SITUATIONS[place]
    model = model or ARMS[arm].model(situation.model(), seed)

    def rollout(order: str) -> Rollout:
        starts = 2 * seed + (order == ZEROTH)
        return situation.rollout(model, situation.policy(), horizon, len(x) * rows, starts)

    return estimates(ORDERS[ARMS[arm].estimator], rollout, x, rows, STD, np.random.default_rng(seed))


def reference(place: str, horizon: int, pairs: int, seed: int) -> Outcome:
    """``mean`` (n,) and its standard ``error``: zeroth order from many starts, unbiased whatever contact does."""
    (found,) = gradients(place, horizon, "zeroth", SITUATIONS[place].start(seed)[None], pairs, seed + 1000)
    return {"mean": found.mean, "error": found.standard_error}


def quality(place: str, horizon: int, arm: str, samples: int, against: Outcome, seed: int) -> Outcome:
    """The estimate at the first policy, compared with ``against``, a :func:`reference`. None: not finite.

    ``norm``; ``signal``: norm over the standard error of the mean; ``cosine`` to the reference; ``norm_range`` and
    ``cosine_range``: 5 and 95 % of a bootstrap over samples; ``failed``: share of samples; ``ms`` per sample.
    """
    x, model = SITUATIONS[place].start(seed)[None], ARMS[arm].model(SITUATIONS[place].model(), seed)
    begin = time.process_time()
    (found,) = gradients(place, horizon, arm, x, samples, seed, model)
    spent = time.process_time() - begin
    mean, norm = found.mean, float(np.linalg.norm(found.mean))
    right = np.array(against["mean"])
    return {
        "situation": place, "horizon": horizon, "arm": arm, "norm": _number(norm),
        "signal": _number(norm / found.standard_error),
        "cosine": _number(mean @ right / (norm * np.linalg.norm(right))),
        "truth_norm": float(np.linalg.norm(right)),
        "truth_signal": float(np.linalg.norm(right) / against["error"]),
        "failed": found.failed / len(found.gradients), "ms": 1e3 * spent / samples, **_ranges(found, right, seed),
    }  # fmt: skip


def _ranges(found: Estimate, right: Array, seed: int) -> dict[str, list[float] | None]:
    finite = found.gradients[np.isfinite(found.gradients).all(axis=1)]
    if not len(finite):
        return {"norm_range": None, "cosine_range": None}
    rows = np.random.default_rng(seed).integers(len(finite), size=(RESAMPLES, len(finite)))
    means = np.stack([finite[chosen].mean(axis=0) for chosen in rows])
    norms = np.linalg.norm(means, axis=1)
    ranges = {"norm_range": norms, "cosine_range": means @ right / (norms * np.linalg.norm(right))}
    return {key: np.quantile(x, (0.05, 0.95)).tolist() if np.isfinite(x).all() else None for key, x in ranges.items()}


def learn(place: str, horizon: int, arm: str, training: Training, seed: int) -> Outcome:
    """All seeds side by side: ``gains``, the final return less the first on starts never trained on, in units of its
    standard deviation over the starts; ``skipped``: updates without a finite gradient, of all seeds."""
    situation = SITUATIONS[place]
    model = ARMS[arm].model(situation.model(), seed)
    x = torch.tensor(np.stack([situation.start(seed + k) for k in range(training.seeds)]))
    before = _judged(situation, horizon, x, training.judged)
    optimiser = torch.optim.Adam([x.requires_grad_()], training.rate, betas=(0.7, 0.95))
    skipped = 0
    begin = time.process_time()
    for update in range(training.updates):
        noise = 1000 * (seed + 1) + update
        found = gradients(place, horizon, arm, x.detach().numpy(), training.batch, noise, model)
        means = np.stack([e.mean for e in found])
        usable = np.asarray(np.isfinite(means).all(axis=1))
        skipped += int((~usable).sum())
        x.grad = torch.from_numpy(-np.where(usable[:, None], means, 0.0))
        optimiser.step()
    seconds = time.process_time() - begin
    after = _judged(situation, horizon, x.detach(), training.judged)
    gains = (after.mean(1) - before.mean(1)) / before.std(1)
    return {"situation": place, "horizon": horizon, "arm": arm, "gains": gains, "skipped": skipped, "seconds": seconds}


def _judged(situation: Situation, horizon: int, x: torch.Tensor, episodes: int) -> Array:
    """Returns (G, episodes) of the policies (G, n) in the hard model, all from the same starts."""
    returns = []
    for weights in x:
        rollout = situation.rollout(situation.model(), situation.policy(), horizon, episodes, HELD_OUT)
        with torch.no_grad():
            returns.append(rollout(weights.expand(episodes, -1)).numpy())
    return np.stack(returns)


def _number(x: Any) -> float | None:
    return float(x) if np.isfinite(x) else None
