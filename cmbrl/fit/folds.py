"""Episodes held out in turn: every episode is predicted by parameters that have not seen it.

One split of a small log often holds out no episode that tells a given parameter (one impact that rubs in ten); in
turn, all of them judge. A fold starts from the parameters fitted on everything and converges on what it may see:
Gauss-Newton with a prior forgets the start also where the fold's data say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.fit.gauss_newton import gauss_newton
from cmbrl.fit.loss import Errors, PredictionLoss
from cmbrl.fit.objective import Objective
from cmbrl.fit.space import Space
from cmbrl.fit.state import Journal

_LEAST_BLOCKS = 6  # with fewer episodes than this they are cut into stretches of consecutive starts


def fold_count(data: Any, holdout: float, needed: bool) -> int:
    """How many folds hold out ``holdout`` of the episodes each; 0 for none, which is refused where one is ``needed``.

    Raises UserError on a share outside [0, 1), and on a single episode.
    """
    if not 0.0 <= holdout < 1.0:
        raise UserError(f"holdout is {holdout}: give a share of the episodes from 0 to below 1")
    if holdout == 0.0:
        if needed:
            raise UserError("holdout 0 leaves nothing to choose parameters by: name them (groups) or hold episodes out")
        return 0
    if data.n_episodes < 2:
        raise UserError(
            "the log has one episode only, and a fit is judged on episodes it has not seen: record a second one, "
            "or name the parameters (groups) and set holdout to 0"
        )
    return min(max(round(1.0 / holdout), 2), data.n_episodes)


def draw_starts(data: Any, horizon: int, limit: int, seed: int) -> np.ndarray:
    """Rows to predict from, at most ``limit`` predicted transitions, drawn without replacement, in the log's order.

    Raises UserError when no episode has ``horizon`` transitions in a row.
    """
    starts = data.windows(horizon)
    if len(starts) == 0:
        raise UserError(f"no episode has {horizon} transitions in a row: choose a shorter horizon")
    limit = max(1, limit // horizon)
    if len(starts) <= limit:
        return starts
    draw = np.random.Generator(np.random.Philox(key=[seed & 0xFFFFFFFFFFFFFFFF, limit]))
    return np.sort(draw.choice(starts, limit, replace=False))


@dataclass(frozen=True)
class Folds:
    """``train[k]`` and ``held_out[k]``: losses on disjoint episodes; the latter together are all of the episodes."""

    train: tuple[PredictionLoss, ...]
    held_out: tuple[PredictionLoss, ...]

    @classmethod
    def of(cls, train: PredictionLoss, judge: PredictionLoss, count: int, seed: int) -> Folds:
        """``count`` folds by episode under ``seed``; starts to fit on are in ``train``, to judge on in ``judge``."""
        episodes = np.unique(train.data.episode)
        draw = np.random.Generator(np.random.Philox(key=[seed & 0xFFFFFFFFFFFFFFFF, count]))
        fold_of = dict(zip(draw.permutation(episodes).tolist(), np.arange(len(episodes)) % count, strict=True))
        row_fold = np.array([fold_of[e] for e in train.data.episode.tolist()])
        pairs = [
            (train.on(train.starts[row_fold[train.starts] != k]), judge.on(judge.starts[row_fold[judge.starts] == k]))
            for k in range(count)
        ]
        # A fold may be empty where rows were drawn from many short episodes.
        return cls(*zip(*[(t, h) for t, h in pairs if len(t.starts) and len(h.starts)], strict=True))

    def refit(
        self, space: Space, active: np.ndarray, z: np.ndarray, iterations: int, journal: Journal
    ) -> tuple[list[np.ndarray], int]:
        """``z`` (n,) refitted without each fold in turn, and the number of candidates that took."""
        if not active.any():
            return [z] * len(self.train), 0
        fitted, candidates = [], 0
        for train in self.train:
            found = gauss_newton(Objective.at(train, space, active, z), z, iterations, journal)
            fitted.append(found.z)
            candidates += found.candidates
        return fitted, candidates

    def errors(self, space: Space, fitted: list[np.ndarray]) -> Errors:
        """Held-out errors when fold k is predicted with ``fitted[k]``; starts are ordered by fold."""
        parts = [loss.errors(space.theta(z)) for loss, z in zip(self.held_out, fitted, strict=True)]
        return Errors(
            np.concatenate([p.loss for p in parts]),
            np.concatenate([p.squares for p in parts]),
            sum(p.failures for p in parts),
        )

    def blocks(self) -> np.ndarray:
        """Block index of every start, ordered by fold: its episode, or a stretch when there are few episodes."""
        episodes = np.concatenate([loss.data.episode[loss.starts] for loss in self.held_out])
        known, index = np.unique(episodes, return_inverse=True)
        if len(known) >= _LEAST_BLOCKS:
            return index
        return np.arange(len(index)) * _LEAST_BLOCKS // len(index)


def paired_gain(before: np.ndarray, after: np.ndarray, blocks: np.ndarray) -> tuple[float, float]:
    """Mean fall of the loss (starts,) and its noise over blocks (starts,) of starts that belong together.

    The noise is the standard error of the mean fall if it were zero, estimated from the blocks that got worse, each
    counted with its mirror image: that one impact in ten tells the friction makes a fall uneven, not uncertain.
    """
    fall = before - after
    worse = np.minimum(np.bincount(blocks, weights=fall), 0.0)
    count = len(worse)
    noise = np.sqrt(2.0 * (worse**2).sum() * count / max(count - 1, 1)) / len(fall)
    return float(fall.mean()), float(noise)
