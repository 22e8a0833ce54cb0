"""Gauss-Newton from several starts: another valley is taken only if held-out episodes are predicted better from there.

Beside the parameters so far, starts are drawn around them, near and far. A few Gauss-Newton iterations on some of the
log tell what each is worth, which costs less than a random search. The lowest loss does not decide: with dozens of
parameters, valleys far from the file explain the fitted episodes a little better and others worse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.fitting.choice.drives import FADE, LIMIT
from cmbrl.fitting.search.folds import LEAST_GAIN, NOISE_FACTOR, Folds, paired_gain
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.objective import NotFinite, Objective
from cmbrl.fitting.search.random_search import Search
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal, OutOfTime

_WIDTHS = (0.3, 1.0)  # of the starts, in turn: prior standard deviations
_EXPLODES = 1e6  # a loss that no motion of a robot has: nothing leads back from there, and its solves are the dearest


@dataclass(frozen=True)
class MultiStart:
    """``count`` starts, ``iterations`` from each. ``folds``: the first one is fitted and judged.

    ``least``: the variance that weighs the prior at least.
    """

    space: Space
    folds: Folds
    active: np.ndarray
    seed: int
    count: int
    iterations: int
    journal: Journal
    least: float = 0.0

    def run(self, start: np.ndarray) -> Search:
        """The best place found from ``start`` (n,) and from around it; ``start`` itself if no other predicts better.

        When the journal's time is up, the best one so far.
        """
        first, *others = self._starts(start)
        best, own, candidates = self._fitted(first)
        worth = float(own.mean())
        least, blocks = LEAST_GAIN * worth, np.unique(self.folds.held_out[0].windows.blocks, return_inverse=True)[1]
        most = 0.0
        for other in others:
            try:
                with np.errstate(all="ignore"):
                    z, loss, count = self._fitted(other)
            except OutOfTime:
                break
            except NotFinite:  # motion explodes with these parameters
                continue
            candidates += count
            gain, noise = paired_gain(own, loss, blocks)
            if gain > max(most, NOISE_FACTOR * noise, least):
                best, most = z, gain
        # From the start itself, the polish finds its own way.
        return Search(best if most > 0.0 else start, worth - most, candidates)

    def _fitted(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """Where a few iterations lead from ``z``, its held-out losses, and the number of candidates."""
        objective = Objective.at(self.folds.train[0], self.space, self.active, z, self.least)
        found = gauss_newton(objective, z, self.iterations, self.journal)
        return found.z, self.folds.held_out[0].errors(self.space.theta(found.z)).loss, found.candidates

    def _starts(self, start: np.ndarray) -> list[np.ndarray]:
        """``start`` and others around it, inside the bounds, without those from which motion explodes."""
        draw = np.random.Generator(np.random.Philox(key=[self.seed & 0xFFFFFFFFFFFFFFFF, self.count]))
        found = [start]
        held = np.isin(self.space.groups, (LIMIT, FADE))  # known from a scan; elsewhere, most have no derivative
        for k in range(1, self.count):
            step = _WIDTHS[k % len(_WIDTHS)] * draw.standard_normal(len(start))
            moved = np.where(self.active & ~held, start + step, start)
            found.append(np.clip(moved, self.space.z_low, self.space.z_high))
        losses = self.folds.train[0].values(self.space.theta(np.array(found)))
        return [start, *(z for z, loss in zip(found[1:], losses[1:], strict=True) if loss < _EXPLODES)]
