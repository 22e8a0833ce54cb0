"""One situation, one horizon, one estimator: what its gradient is like, and whether one learns by it.

All estimators ask for the gradient of the same thing: the hard return, averaged over starts and over normal noise of
deviation ``STD`` on the policy's weights, which makes it smooth. First-order ones differentiate at noisy weights,
zeroth order takes differences of opposite noise, AoBG mixes both. Rows that belong together are groups, one a seed.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cmbrl.bench.cells import kept
from cmbrl.bench.studies.estimators.contenders import ABS, CONTENDERS, EXACT
from cmbrl.bench.studies.horizons.situations import SITUATIONS, Situation
from cmbrl.gradients import Estimate, aobg
from cmbrl.gradients.estimate import Array
from cmbrl.gradients.kinds import DerivativeModel
from cmbrl.gradients.rollout import Rollout, TanhPolicy

STD = 0.05  #: of the noise on weights
HELD_OUT = 10_000_000  #: seed of the starts on which learners are judged
NAMES = (EXACT, "BS 1e-4", ABS, "bundle", "BCG", "zeroth", "AoBG")


@dataclass(frozen=True)
class Work:
    """Sizes."""

    horizons: tuple[int, ...] = (32, 64, 128, 256, 512)
    samples: int = 64  #: of the gradient that is looked at
    truth: int = 2048  #: pairs of zeroth order that it is compared with
    learning: tuple[int, ...] = (32, 128, 512)  #: horizons at which policies are trained
    updates: int = 30
    batch: int = 8  #: episodes of an update
    rate: float = 0.05  #: of Adam, in weights
    seeds: int = 3
    judged: int = 32  #: episodes by which a policy is judged


QUICK = Work(horizons=(8, 32), samples=16, truth=64, learning=(8, 32), updates=3, batch=4, seeds=2, judged=8)


@dataclass(frozen=True)
class Ask:
    """A gradient estimator on a situation over one horizon."""

    name: str
    situation: Situation
    horizon: int

    def groups(
        self, weights: Array, rows: int, seed: int, model: DerivativeModel, policy: TanhPolicy
    ) -> list[Estimate]:
        """One estimate from ``rows`` samples for each of the policies (G, n)."""
        rng = np.random.default_rng(seed)
        x = np.repeat(weights, rows, axis=0)

        def split(found: Array) -> list[Estimate]:
            return [Estimate(part, 0) for part in found.reshape(len(weights), rows, -1)]

        def rollout(shift: int) -> Rollout:
            return self.situation.rollout(model, policy, self.horizon, len(x), 2 * seed + shift)

        kind = CONTENDERS[self.name].estimator
        with np.errstate(over="ignore", invalid="ignore"):
            if kind == "zeroth":
                return split(zeroth_order(rollout(1), x, rng))
            first = split(first_order(rollout(0), x, rng))
            if kind == "pathwise":
                return first
            zeroth = split(zeroth_order(rollout(1), x, rng))
            return [aobg(a, b)[0] for a, b in zip(first, zeroth, strict=True)]


def first_order(rollout: Rollout, x: Array, rng: np.random.Generator) -> Array:
    """Derivatives (B, n) of each row's return at its own weights (B, n), disturbed."""
    points = torch.tensor(x + STD * rng.normal(size=x.shape), requires_grad=True)
    (found,) = torch.autograd.grad(rollout(points).sum(), points)
    return np.asarray(found.numpy())


def zeroth_order(rollout: Rollout, x: Array, rng: np.random.Generator) -> Array:
    """w (f(x + w) - f(x - w)) / (2 STD^2), a row each (B, n)."""
    w = STD * rng.normal(size=x.shape)
    with torch.no_grad():
        up, down = (rollout(torch.from_numpy(x + sign * w)).numpy() for sign in (1, -1))
    return np.asarray(w * ((up - down) / (2 * STD**2))[:, None])


def truth(folder: Path, place: str, horizon: int, seed: int, work: Work) -> dict[str, Any]:
    """{"mean": (n,), "error": of it}: zeroth order from many starts, without bias whatever contact does."""
    situation = SITUATIONS[place]
    key = {"situation": asdict(situation), "horizon": horizon, "seed": seed, "pairs": work.truth, "std": STD}

    def compute() -> dict[str, Any]:
        policy = situation.policy()
        x = situation.start(policy.size, seed)[None]
        (found,) = Ask("zeroth", situation, horizon).groups(x, work.truth, seed + 1000, situation.model(), policy)
        return {"mean": found.mean.tolist(), "error": found.standard_error}

    return dict(kept(folder / f"{place}_{horizon}_truth_{seed}.json", key, compute))


def quality(folder: Path, place: str, horizon: int, name: str, seed: int, work: Work) -> dict[str, Any]:
    """The estimate at the first policy: ``norm``, ``signal`` (norm over the standard error of the mean), ``cosine`` to
    the truth and ``truth_signal``, ``failed`` (share of samples), ``ms`` a sample. Without a finite value: None."""
    situation, against = SITUATIONS[place], truth(folder, place, horizon, seed, work)
    key = {"situation": asdict(situation), "horizon": horizon, "contender": asdict(CONTENDERS[name]), "seed": seed,
           "samples": work.samples, "pairs": work.truth, "std": STD}  # fmt: skip

    def compute() -> dict[str, Any]:
        policy = situation.policy()
        x = situation.start(policy.size, seed)[None]
        model = CONTENDERS[name].model(situation.model(), seed)
        begin = time.process_time()
        (found,) = Ask(name, situation, horizon).groups(x, work.samples, seed, model, policy)
        spent = time.process_time() - begin
        mean, norm = found.mean, float(np.linalg.norm(found.mean))
        right = np.array(against["mean"])
        return {
            "situation": place, "horizon": horizon, "name": name, "norm": _number(norm),
            "signal": _number(norm / found.standard_error),
            "cosine": _number(mean @ right / (norm * np.linalg.norm(right))),
            "truth_norm": float(np.linalg.norm(right)),
            "truth_signal": float(np.linalg.norm(right) / against["error"]),
            "failed": found.failed / len(found.gradients), "ms": 1e3 * spent / work.samples,
        }  # fmt: skip

    return dict(kept(folder / f"{place}_{horizon}_{name}_{seed}.json".replace(" ", "_"), key, compute))


def learn(folder: Path, place: str, horizon: int, name: str, seed: int, work: Work) -> dict[str, Any]:
    """All seeds side by side: ``gains``, the final return less the first on starts never trained on, in units of its
    standard deviation over the starts; ``skipped``: updates without a finite gradient, of all seeds."""
    situation = SITUATIONS[place]
    key = {"situation": asdict(situation), "horizon": horizon, "contender": asdict(CONTENDERS[name]), "seed": seed,
           "updates": work.updates, "batch": work.batch, "rate": work.rate, "seeds": work.seeds, "judged": work.judged,
           "std": STD}  # fmt: skip

    def compute() -> dict[str, Any]:
        policy, hard = situation.policy(), situation.model()
        model = CONTENDERS[name].model(hard, seed)
        ask = Ask(name, situation, horizon)
        x = torch.tensor(np.stack([situation.start(policy.size, seed + k) for k in range(work.seeds)]))
        before = _judged(situation, policy, horizon, x, work)
        optimiser = torch.optim.Adam([x.requires_grad_()], work.rate, betas=(0.7, 0.95))
        skipped = 0
        begin = time.process_time()
        for update in range(work.updates):
            found = ask.groups(x.detach().numpy(), work.batch, 1000 * (seed + 1) + update, model, policy)
            means = np.stack([e.mean for e in found])
            usable = np.asarray(np.isfinite(means).all(axis=1))
            skipped += int((~usable).sum())
            x.grad = torch.from_numpy(-np.where(usable[:, None], means, 0.0))
            optimiser.step()
        seconds = time.process_time() - begin
        gains = (_judged(situation, policy, horizon, x.detach(), work).mean(1) - before.mean(1)) / before.std(1)
        return {"situation": place, "horizon": horizon, "name": name, "gains": gains.tolist(), "skipped": skipped,
                "seconds": seconds}  # fmt: skip

    return dict(kept(folder / f"{place}_{horizon}_{name}_{seed}_learned.json".replace(" ", "_"), key, compute))


def _judged(situation: Situation, policy: TanhPolicy, horizon: int, x: torch.Tensor, work: Work) -> Array:
    """Returns (G, judged) of the policies (G, n) in the hard model, all from the same starts."""
    returns = []
    for weights in x:
        rollout = situation.rollout(situation.model(), policy, horizon, work.judged, HELD_OUT)
        with torch.no_grad():
            returns.append(rollout(weights.expand(work.judged, -1)).numpy())
    return np.stack(returns)


def _number(x: Any) -> float | None:
    return float(x) if np.isfinite(x) else None
