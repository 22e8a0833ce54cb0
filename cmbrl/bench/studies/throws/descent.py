"""Descent to a launch velocity: many runs in one batch, each with its own decision and its own model parameters.

A decision is the action of the task's process, two numbers in [-1, 1]. The objective is the mean return over the starts
of that process and, where there are several, over the parameter sets that explain a log.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from cmbrl.bench.groups import estimates
from cmbrl.bench.studies.throws.arms import Arm
from cmbrl.envs.evaluation import evaluate_real
from cmbrl.gradients.estimate import Array, Estimate
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.system import SystemFactory


@dataclass(frozen=True)
class Rule:
    """How every estimator steps."""

    iterations: int = 40
    throws: int = 6  #: per gradient, however they are spent
    rate: float = 0.1  #: of Adam, falls linearly to 0; an action's range is 2
    std: float = 0.1  #: of the noise on the decision where an estimator needs noise; falls like the rate


@dataclass(frozen=True)
class Throw:
    """Returns of one throw each, an ``Objective`` of the decisions: starts q (B, nq), v (B, nv), parameters (B, np)."""

    mdp: MDP
    model: ComplementarityModel
    q: Tensor
    v: Tensor
    theta: Tensor

    @property
    def steps(self) -> int:
        """Model steps of a throw."""
        return self.mdp.repeat

    def __call__(self, x: Tensor) -> Tensor:
        """Minus the squared distance to the goal (B,) [m^2] of the decisions x (B, n)."""
        q, v, u = self.mdp.act(self.q, self.v, x)
        for _ in range(self.mdp.repeat):
            q, v = self.model.step(q, v, u, self.theta)
        return self.mdp.reward(self.q, self.v, x, q, v)


class Sampler:
    """Gradients by one arm at fresh starts, parameters and noise, all drawn from one seed."""

    def __init__(self, place: Range, arm: Arm, seed: int) -> None:
        self.place, self.arm = place, arm
        self.rng, self.generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
        self.soft = arm.soften(place.model)

    def __call__(self, x: Array, throws: int, std: float) -> list[Estimate]:
        """One estimate for each of the decisions x (R, n), from ``throws`` throws each."""
        samples = throws // self.arm.throws

        def fresh(order: str) -> Throw:
            return self.place.throw(self.soft, samples, self.rng, self.generator)

        with unwarned():
            return estimates(self.arm.orders, fresh, x, samples, std, self.rng)


@dataclass(frozen=True)
class Range:
    """Where R runs throw. Every throw draws one of the run's possible parameter sets, ``sets`` (R, K, np)."""

    mdp: MDP
    model: ComplementarityModel
    sets: Array

    def descend(self, arm: Arm, start: Array, rule: Rule, seed: int) -> Array:
        """Decisions (iterations + 1, R, n) from ``start`` (R, n) on; a gradient that is not finite moves nothing."""
        gradients = Sampler(self, arm, seed)
        x = torch.tensor(start, requires_grad=True)
        adam = torch.optim.Adam([x], rule.rate)
        path = [start]
        for k in range(rule.iterations):
            left = 1 - k / rule.iterations
            adam.param_groups[0]["lr"] = rule.rate * left
            gradient = np.stack([found.mean for found in gradients(path[-1], rule.throws, rule.std * left)])
            x.grad = -torch.from_numpy(np.where(np.isfinite(gradient), gradient, 0.0))
            adam.step()
            with torch.no_grad():
                x.clamp_(-1.0, 1.0)
            path.append(x.detach().numpy().copy())
        return np.stack(path)

    def throw(
        self, model: ComplementarityModel, count: int, rng: np.random.Generator, generator: torch.Generator
    ) -> Throw:
        """``count`` throws for each run, with starts and parameters drawn now."""
        runs, choices, width = self.sets.shape
        chosen = rng.integers(choices, size=(runs, count))
        theta = np.take_along_axis(self.sets, chosen[..., None], axis=1).reshape(-1, width)
        return Throw(self.mdp, model, *self.mdp.reset(runs * count, generator), torch.from_numpy(theta))

    def returns(self, x: Array, count: int, seed: int) -> Array:
        """Mean return (R,) of decisions x (R, n) over ``count`` throws of the hard model."""
        throw = self.throw(self.model, count, np.random.default_rng(seed), torch.Generator().manual_seed(seed))
        with torch.no_grad(), unwarned():
            return throw(torch.from_numpy(np.repeat(x, count, axis=0))).reshape(len(x), count).mean(dim=1).numpy()

    def distances(self, path: Array) -> Array:
        """Distance to the goal [m] (T, R) of decisions (T, R, n), from the middle of the starts, by the first set."""
        times, runs, _ = path.shape
        mdp = centred(self.mdp)
        q, v = mdp.reset(times * runs, torch.Generator())
        theta = torch.from_numpy(np.tile(self.sets[:, 0], (times, 1)))
        with torch.no_grad(), unwarned():
            value = Throw(mdp, self.model, q, v, theta)(torch.from_numpy(path.reshape(times * runs, -1)))
        return np.sqrt(-value.numpy()).reshape(times, runs)


def centred(mdp: MDP) -> MDP:
    """The process with every start in the middle of those that ``mdp`` draws (uniform: the mean of the extremes)."""
    q, v = (x.aminmax(dim=0) for x in mdp.reset(4096, torch.Generator().manual_seed(0)))
    middle_q, middle_v = ((x.min + x.max)[None] / 2 for x in (q, v))
    return replace(mdp, reset=lambda count, generator: (middle_q.repeat(count, 1), middle_v.repeat(count, 1)))


def real_distances(mdp: MDP, system: SystemFactory, x: Array, seed: int = 0) -> Array:
    """Distance to the goal [m] (R,) in the real system for the decisions x (R, n), one throw each."""
    actions = torch.from_numpy(x)
    return np.sqrt(-evaluate_real(lambda o: actions, mdp, system, len(x), seed).returns)


@contextmanager
def unwarned() -> Iterator[None]:
    """Silences warnings of failed solves: their samples are wrong or not finite, which the result shows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SolverWarning)
        yield
