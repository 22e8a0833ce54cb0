"""Intervals of the fitted parameters, and what the data leave open.

At the optimum, with the Gauss-Newton information of the data ``F = m H / tau^2``, m independent observations as in the
objective, and the precision K of the prior in z:

    cov = A^-1 (S + K) A^-1 + D,   A = F + K,   S = E / (E - 1) sum_e (s_e - s) (s_e - s)^T

where s_e is the score of episode e. The sandwich (Huber 1967; White 1982; clustered by episode) allows for residuals
that are similar within an episode. Episodes are few, so a parameter gets the larger of this variance and the naive
one, A^-1. D is what a wrong model adds, which no longer log would take away (``discrepancy``). Where the model leaves
a share tau^2 of the motion unexplained, its faults repeat all over the log, and F and S are those of 1 + 20 tau^2
times fewer observations: 1.02 for a log of MuJoCo, 4 for one of a robot with backlash, late commands and noisy
sensors. The 20 was chosen on draws of ``cmbrl bench coverage`` that it is not judged on. Directions with F below 1 are
flat: the log says less there than the prior.

A fit moves what held-out errors call for. What it leaves at the file's value may be wrong all the same, within the
prior, and others make up for it: a centre of mass for a payload, say. So A has the columns of all that might have been
fitted, and a parameter's interval is as wide as if all of them had been.

A log without noise tells some combinations 1e15 times as well as the prior, or better, and the unit of force not at
all: F + K holds no digit of K in doubles. So everything is computed from square roots of both (``square_root``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.search.square_root import Inverse, root_of, without

_NORMAL_95 = 1.96
REPEATED = 20.0  #: by the share of the motion that the model leaves unexplained
_NAMED = 0.3  # of the largest coefficient; smaller ones are not named
_MAX_NAMED = 6
_FLAT_VARIANCE = 0.5 - 1e-6  # of the prior's; two that are told in their sum alone have half of it each
_LEAST_EIGENVALUE = 1e-15  # relative; below, rounding rules
_INSIDE = 1e-9  # prior standard deviations off: a direction is among those of a basis
_SILENT = 1e-6  # information, in units of the prior's, below which the log says nothing


@dataclass(frozen=True)
class Identification:
    """``low``, ``high`` (n,): 95 % intervals in the parameters' own units; the nominal value if not fitted.

    ``flat`` (n,) bool: fitted, but the data leave at least half of the prior's variance. ``unseen`` (n,) bool: not
    fitted, and the data would not determine it. ``directions``: flat combinations of fitted parameters, each
    {"information", "parameters": {name: coefficient}} with coefficients in prior standard deviations, the largest 1.
    ``covariance`` (n, n) in z, in the unit of force of the parameters that stay; zero for those that are not fitted or
    flat. ``every`` (n, n): the same with the flat ones. ``apart`` (n, n): where what was not fitted may be wrong, but
    for what sets the unit of force. ``wide`` (n, n): that of the intervals, in any unit of force.
    """

    low: np.ndarray
    high: np.ndarray
    flat: np.ndarray
    unseen: np.ndarray
    directions: list[dict]
    covariance: np.ndarray
    every: np.ndarray
    apart: np.ndarray
    wide: np.ndarray


def identify(
    space: Space,
    z: np.ndarray,
    fitted: np.ndarray,
    equations: NormalEquations,
    discrepancy: np.ndarray,
    sets: Sequence[Sequence[int]] = (),
    beside: np.ndarray | None = None,
    free: np.ndarray | None = None,
) -> Identification:
    """Intervals and flat directions of the ``fitted`` columns at ``z``, from ``equations`` without the prior.

    ``discrepancy`` (n, n): the covariance that a wrong model adds. ``sets``: columns that motion tells up to a common
    factor, also where only some of them are fitted. ``beside`` (n, n): a covariance that intervals alone allow for.
    ``free`` (n,): what might have been fitted; default: what was.
    """
    repeated = 1.0 + REPEATED * equations.variance
    scale = equations.independent / max(equations.variance, 1e-12) / repeated
    columns = np.flatnonzero(fitted)
    own = np.ix_(columns, columns)
    every, apart, wide = (np.zeros_like(space.precision) for _ in range(3))
    directions = []
    if len(columns):
        factors = _factors(space, z, fitted, sets)
        root = equations.root if equations.root is not None else root_of(equations.hessian)
        told = _Told(space, np.sqrt(scale) * root, scale * equations.episode_gradients, factors, repeated)

        def spread(others: np.ndarray) -> np.ndarray:
            """Of the fitted columns, where ``others`` (n, k) may be wrong as well."""
            found = told.spread(np.hstack([np.eye(len(space))[:, columns], others]))[0]
            return found[: len(columns), : len(columns)] + discrepancy[own]

        staying = np.where(fitted[:, None], 0.0, factors)
        staying = staying[:, staying.any(axis=0)]
        left = np.zeros_like(fitted) if free is None else free & ~fitted & ~staying.any(axis=1)
        others = np.eye(len(space))[:, left]
        every[own], apart[own], wide[own] = map(spread, (others[:, :0], others, np.hstack([others, staying])))
        if staying.shape[1]:
            more = np.hstack([np.eye(len(space))[:, columns], staying])
            bread = told.spread(more)[1][: len(columns), len(columns) :]
            drift = bread @ (staying.T @ (scale * repeated * equations.gradient + space.precision @ z))
            wide[own] += np.outer(drift, drift)
        wide[own] += 0.0 if beside is None else beside[own]
        directions = _flat_directions(told.root[:, columns], [space.names[k] for k in columns])
    variance = np.where(fitted, np.diag(wide), 1.0)
    half = _NORMAL_95 * np.sqrt(variance)
    low = np.where(fitted, space.theta(np.maximum(z - half, space.z_low)), space.theta(z))
    high = np.where(fitted, space.theta(np.minimum(z + half, space.z_high)), space.theta(z))
    alone = scale * np.diag(equations.hessian)
    covariance, silent = every.copy(), np.diag(every) > _FLAT_VARIANCE
    covariance[silent], covariance[:, silent] = 0.0, 0.0
    flat = fitted & (variance > _FLAT_VARIANCE)
    return Identification(low, high, flat, ~fitted & (alone < 1.0), directions, covariance, every, apart, wide)


@dataclass(frozen=True)
class _Told:
    """What a log tells: ``root`` (m, n) of its information, and ``scores`` (episodes, n).

    Of ``factors`` (n, k), along which no motion changes, it tells nothing; in its numbers rounding would.
    """

    space: Space
    root: np.ndarray
    scores: np.ndarray
    factors: np.ndarray
    repeated: float

    def spread(self, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariance of the sandwich, at least the naive one, and A^-1, (k, k): along directions ``basis`` (n, k)."""
        root, scores = self.root @ basis, self.scores @ basis
        along = np.linalg.lstsq(basis, self.factors, rcond=None)[0]
        inside = np.abs(basis @ along - self.factors).max(axis=0, initial=0.0) < _INSIDE
        if inside.any():
            kept = without(root, along[:, inside])
            root, scores = root @ kept, scores @ kept
        prior = root_of(basis.T @ self.space.precision @ basis)
        bread = Inverse.of(np.vstack([root, prior]))
        scores = scores - scores.mean(axis=0)
        scores = scores * np.sqrt(self.repeated * len(scores) / max(len(scores) - 1, 1))
        sandwich = bread.around(np.vstack([scores, prior]))
        wider = np.sqrt(np.maximum(np.diag(bread.matrix) / np.maximum(np.diag(sandwich), 1e-300), 1.0))
        return sandwich * np.outer(wider, wider), bread.matrix


def _factors(space: Space, z: np.ndarray, fitted: np.ndarray, sets: Sequence[Sequence[int]]) -> np.ndarray:
    """Directions (n, k) in z of the common factors of ``sets`` of which some parameter is ``fitted``."""
    theta, slope, found = space.theta(z), space.slope(z), []
    for together in sets:
        some = np.isin(np.arange(len(z)), together) & (theta > 0.0)
        if (some & fitted).any():
            found.append(np.where(some, theta / slope, 0.0))
    return np.array(found).reshape(-1, len(z)).T


def inverse(matrix: np.ndarray) -> np.ndarray:
    """The inverse (n, n) of a positive definite matrix, positive definite too where rounding would not leave it so.

    Without noise, what the log tells of one direction may be 1e16 times what the prior tells of another.
    """
    scale = 1.0 / np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    root = vectors * (scale[:, None] / np.sqrt(np.maximum(values, _LEAST_EIGENVALUE * values[-1])))
    return np.asarray(root @ root.T)


def _flat_directions(root: np.ndarray, names: list[str]) -> list[dict]:
    silent = np.square(root).sum(axis=0) < _SILENT  # one direction each; together, any rotation of them would do
    found = [{"information": 0.0, "parameters": {names[k]: 1.0}} for k in np.flatnonzero(silent)]
    told = np.flatnonzero(~silent)
    _, sizes, vectors = np.linalg.svd(root[:, told])
    values = np.append(sizes**2, np.zeros(len(vectors) - len(sizes)))
    for value, vector in zip(values[::-1], vectors[::-1], strict=True):
        if value >= 1.0:
            break
        vector = vector / vector[np.abs(vector).argmax()]
        order = np.argsort(-np.abs(vector), kind="stable")[:_MAX_NAMED]
        named = {names[told[k]]: round(float(vector[k]), 3) for k in order if abs(vector[k]) >= _NAMED}
        found.append({"information": max(float(value), 0.0), "parameters": named})
    return found
