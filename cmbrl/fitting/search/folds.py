"""Episodes held out in turn, so that every episode is predicted by parameters that were fitted without it.

A single split of a small log often holds out no episode that informs a given parameter (say, one sliding impact in
ten). A fold starts from the parameters fitted to everything and converges on its own episodes: Gauss-Newton with a
prior forgets the start, even where the fold's data are uninformative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.loss_values import Errors
from cmbrl.fitting.search.objective import SOLVER_VARIANCE, Objective
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal
from cmbrl.models.windows import blocks_of

NOISE_FACTOR, LEAST_GAIN = 2.0, 0.01  #: a fall of the held-out loss counts above so many times its noise and this share
_DECREASE = 1e-3  # of the objective by an iteration; less tells nothing of what is held out
SOLVED = 0.5 * SOLVER_VARIANCE  #: a loss that the solver's accuracy leaves
_LEAST_BLOCKS = 6  # fewer episodes are cut into this many runs of consecutive starts


def fold_count(data: Transitions, holdout: float, needed: bool) -> int:
    """Number of folds that each hold out a share ``holdout`` of the episodes; 0 for no folds.

    Raises UserError for a share outside [0, 1), and for no folds if they are ``needed``.
    """
    if not 0.0 <= holdout < 1.0:
        raise UserError(f"holdout is {holdout}; give a share of the episodes, at least 0 and below 1")
    if holdout == 0.0:
        if needed:
            raise UserError(
                "selecting parameters needs held-out episodes: name the parameters (groups), or set holdout above 0"
            )
        return 0
    return min(max(round(1.0 / holdout), 2), len(np.unique(blocks_of(data))))


def windows_in_blocks(data: Transitions, horizon: int) -> np.ndarray:
    """First rows of all windows of ``horizon`` steps that lie in one block."""
    starts, blocks = data.windows(horizon), blocks_of(data)
    return starts[blocks[starts] == blocks[starts + horizon - 1]]


def draw_starts(data: Transitions, horizon: int, limit: int, seed: int, folds: int = 0) -> np.ndarray:
    """Rows to predict from, in the log's order, for at most ``limit`` transitions: one of each stretch of the log.

    So windows lie all over the log. Drawn anywhere, those that a fit of a quadruped can afford cover half of its log,
    some of it several times, and what it then explains is not what comes next.
    Where all of them lie in one of several ``folds``, one of another fold is added: what is held out has to differ from
    what is fitted, also where a window is nearly as long as ``limit``.
    Raises UserError if no episode has ``horizon`` consecutive transitions.
    """
    starts = windows_in_blocks(data, horizon)
    if len(starts) == 0:
        raise UserError(f"no episode has {horizon} consecutive transitions; choose a shorter horizon")
    limit = max(1, limit // horizon)
    if len(starts) <= limit:
        return starts
    draw = np.random.Generator(np.random.Philox(key=[seed & 0xFFFFFFFFFFFFFFFF, limit]))
    edges = np.linspace(0, len(starts), limit + 1).astype(np.int64)
    drawn = starts[edges[:-1] + (draw.random(limit) * np.diff(edges)).astype(np.int64)]
    if folds < 2:
        return drawn
    fold = fold_of_rows(data, folds, seed)
    others = starts[fold[starts] != fold[drawn[0]]]
    one = bool((fold[drawn] == fold[drawn[0]]).all())
    return np.sort(np.append(drawn, others[: int(one)]))


def fold_of_rows(data: Transitions, count: int, seed: int) -> np.ndarray:
    """Number (N,) of the fold, of ``count``, that holds each row out; blocks are held out as a whole."""
    block = blocks_of(data)
    blocks, place = np.unique(block, return_inverse=True)
    draw = np.random.Generator(np.random.Philox(key=[seed & 0xFFFFFFFFFFFFFFFF, count]))
    fold = np.empty(len(blocks), dtype=np.int64)
    fold[np.searchsorted(blocks, draw.permutation(blocks))] = np.arange(len(blocks)) % count
    return fold[place]


def folds_held_out(count: int, share: float) -> int:
    """How many of ``count`` folds a ``share`` of them is: two at least, since forecasts tell one by the others."""
    return min(count, max(2, round(share * count)))


@dataclass(frozen=True)
class Folds:
    """Losses ``train[k]`` and ``held_out[k]`` on disjoint episodes; all held-out ones together are all episodes."""

    train: tuple[PredictionLoss, ...]
    held_out: tuple[PredictionLoss, ...]

    @classmethod
    def of(cls, train: PredictionLoss, judge: PredictionLoss, count: int, seed: int, share: float = 1.0) -> Folds:
        """``count`` folds by episode under ``seed``, with windows to fit in ``train`` and to judge by in ``judge``.

        Only a ``share`` of them where time is short. Raises UserError if all windows lie in one fold.
        """
        starts, judged = train.windows.starts, judge.windows.starts
        row_fold = fold_of_rows(train.windows.data, count, seed)
        pairs = [
            (train.on(starts[row_fold[starts] != k]), judge.on(judged[row_fold[judged] == k])) for k in range(count)
        ]
        # A fold may be empty if rows were drawn from many short episodes.
        sound = [(t, h) for t, h in pairs if t.steps and h.steps]
        if not sound:
            raise UserError(
                f"only one episode has {train.windows.horizon} consecutive transitions, so that none can be held out: "
                "leave out the short ones (a log of one episode is held out in parts), or choose a shorter horizon"
            )
        return cls(*zip(*sound[: folds_held_out(len(sound), share)], strict=True))

    def refit(
        self, space: Space, active: np.ndarray, z: np.ndarray, iterations: int, journal: Journal, least: float = 0.0
    ) -> tuple[list[np.ndarray], int]:
        """``z`` (n,) refitted without each fold in turn, and the number of candidates used.

        ``least``: the variance that weighs the prior at least.
        """
        if not active.any():
            return [z] * len(self.train), 0
        fitted, candidates = [], 0
        for train in self.train:
            found = gauss_newton(
                Objective.at(train, space, active, z, least), z, iterations, journal, decrease=_DECREASE
            )
            fitted.append(found.z)
            candidates += found.candidates
        return fitted, candidates

    def errors(self, space: Space, fitted: list[np.ndarray]) -> Errors:
        """Held-out errors of fold k at ``fitted[k]``, with starts ordered by fold."""
        parts = [loss.errors(space.theta(z)) for loss, z in zip(self.held_out, fitted, strict=True)]
        return Errors(
            np.concatenate([p.loss for p in parts]),
            np.concatenate([p.squares for p in parts]),
            sum(p.failures for p in parts),
            float(np.mean([p.alike for p in parts])),
        )

    def blocks(self) -> np.ndarray:
        """Block of every start, ordered by fold: its episode, or a run of starts if there are few episodes."""
        known, index = np.unique(np.concatenate([loss.windows.blocks for loss in self.held_out]), return_inverse=True)
        if len(known) >= _LEAST_BLOCKS:
            return index
        return np.arange(len(index)) * _LEAST_BLOCKS // len(index)


def paired_gain(before: np.ndarray, after: np.ndarray, blocks: np.ndarray) -> tuple[float, float]:
    """Mean fall of the loss (starts,), and its noise given the blocks (starts,) of the starts.

    The noise is the standard error of a zero mean fall, estimated from the blocks that got worse, each counted with its
    mirror image: if one impact in ten informs the friction, the fall is uneven but not uncertain.
    """
    fall = before - after
    worse = np.minimum(np.bincount(blocks, weights=fall), 0.0)
    count = len(worse)
    noise = np.sqrt(2.0 * (worse**2).sum() * count / max(count - 1, 1)) / len(fall)
    return float(fall.mean()), float(noise)


def typical_rise(before: np.ndarray, after: np.ndarray, blocks: np.ndarray) -> tuple[float, float]:
    """Mean logarithm of how many times larger the loss ``after`` is than ``before``, by block, and its standard error.

    A single start that no fit predicts well (an impact, a foot that just slips, a pose that the others do not have)
    rules a mean of losses, of all the log or of its block, and its chance hides what all the others say. Here each
    start counts alike in its block, and each block alike. What the solver's accuracy leaves tells nothing.
    """
    told = np.isfinite(before) & np.isfinite(after)
    places, block = np.unique(blocks[told], return_inverse=True)
    if len(places) < 2:
        return 0.0, np.inf
    ratio = np.log((after[told] + SOLVED) / (before[told] + SOLVED))
    mean = np.bincount(block, weights=ratio) / np.bincount(block)
    return float(mean.mean()), float(mean.std(ddof=1) / np.sqrt(len(mean)))
