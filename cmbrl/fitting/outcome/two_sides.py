"""Two logs side by side: parameters common to both but for some, and how sure the difference of these is.

With information F_1, F_2 of the two sides, the precision K of the prior in z, and a change d of the parameter j in the
first one,

    M = F_1 + F_2 + K,   R = F_1 M^-1,   s_j = F_1jj + 1 - (R F_1)_jj,   d_j = -(g_1 - R (g_1 + g_2 + K z))_j / s_j

is the step of Gauss-Newton from the common fit in all parameters and in d, whose prior deviation is 1. Its variance is
that of the episodes' scores (as in ``identify``), at least 1 / s_j, and what the fit moves where something changes that
should not matter (``discrepancy``): where the model is wrong, no two logs ask for quite the same parameters.
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.outcome.identify import REPEATED, inverse
from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.search.objective import SOLVER_VARIANCE
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.search.square_root import root_of


def score_tests(
    space: Space,
    z: np.ndarray,
    own: NormalEquations,
    others: NormalEquations,
    active: np.ndarray,
    discrepancy: np.ndarray,
) -> np.ndarray:
    """By how many standard deviations (n,) each ``active`` parameter would differ, by itself; 0 for the others.

    Both sides are taken at the common ``z`` (n,); ``discrepancy`` (n, n): covariance in z.
    """
    columns = np.flatnonzero(active)
    square = np.ix_(columns, columns)
    (first, mine), (second, theirs), repeated = _weighed(own, others, columns)
    prior = space.precision[square]
    bread = inverse(first + second + prior)
    across = first @ bread
    told = np.maximum(np.diag(first) + 1.0 - np.einsum("ij,ij->i", across, first), 1e-12)
    total = mine.sum(axis=0) + theirs.sum(axis=0) + prior @ z[columns]
    step = -(mine.sum(axis=0) - across @ total) / told
    variance = repeated * (_spread(mine - mine @ across.T) + _spread(theirs @ across.T))
    variance = (variance + np.einsum("ij,ij->i", across @ prior, across) + 1.0) / told**2
    found = np.zeros(len(z))
    found[columns] = np.abs(step) / np.sqrt(np.maximum(variance, 1.0 / told) + np.diag(discrepancy)[columns])
    return found


def joint_deviations(
    space: Space, own: NormalEquations, others: NormalEquations, active: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations (k,) in z of the parameters at ``places`` (k,): in one log, in the others, of the difference.

    All other ``active`` (n,) ones are common to both. What the model lacks does not count: where logs disagree, it
    cannot be told from that.
    """
    columns = np.flatnonzero(active)
    count, extra = len(columns), len(places)
    mine, between = np.searchsorted(columns, places), np.zeros((extra, count + extra))
    to_others = np.eye(count, count + extra)
    to_own = to_others.copy()
    to_own[mine, mine], to_own[mine, count + np.arange(extra)] = 0.0, 1.0
    between[np.arange(extra), mine], between[np.arange(extra), count + np.arange(extra)] = -1.0, 1.0
    prior = to_others.T @ space.precision[np.ix_(columns, columns)] @ to_others + between.T @ between
    (first, scores), (second, theirs), repeated = _weighed(own, others, columns)
    bread = inverse(to_own.T @ first @ to_own + to_others.T @ second @ to_others + prior)
    moved = np.vstack([(x - x.mean(axis=0)) @ way for x, way in ((scores, to_own), (theirs, to_others))])
    rows = np.vstack([np.sqrt(repeated * len(moved) / max(len(moved) - 2, 1)) * moved, root_of(prior)]) @ bread
    sandwich = rows.T @ rows  # positive also in rounding
    wider = np.sqrt(np.maximum(np.diag(bread) / np.maximum(np.diag(sandwich), 1e-300), 1.0))
    covariance = sandwich * np.outer(wider, wider)
    variances = np.diag(covariance)[count:], np.diag(covariance)[mine], np.diag(between @ covariance @ between.T)
    here, there, apart = (np.sqrt(np.maximum(x, 1e-300)) for x in variances)
    return here, there, apart


def _weighed(
    own: NormalEquations, others: NormalEquations, columns: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray], float]:
    """By side, information (n, n) and scores (episodes, n), by the variance of both; what ``identify`` has repeated."""
    sides = (own, others)
    variance = sum(e.independent * e.variance for e in sides) / max(sum(e.independent for e in sides), 1e-300)
    repeated = 1.0 + REPEATED * variance
    scales = [e.independent / max(variance, SOLVER_VARIANCE) / repeated for e in sides]
    first, second = (
        (scale * e.hessian[np.ix_(columns, columns)], scale * e.episode_gradients[:, columns])
        for scale, e in zip(scales, sides, strict=True)
    )
    return first, second, repeated


def _spread(scores: np.ndarray) -> np.ndarray:
    """Variance (n,) of the sum of ``scores`` (episodes, n)."""
    away = scores - scores.mean(axis=0)
    spread: np.ndarray = (away**2).sum(axis=0) * len(scores) / max(len(scores) - 1, 1)
    return spread
