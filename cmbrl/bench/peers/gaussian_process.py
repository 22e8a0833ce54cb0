"""A Gaussian process as next-state model: scikit-learn's, with the inputs and targets of the neural ensemble.

One process per coordinate, as in PILCO (Deisenroth and Rasmussen 2011). Its kernel is a constant times a squared
exponential with a length scale per input, plus white noise. One process for all coordinates has an error a third larger
on 1,000 hopper transitions. Hyperparameters maximise the marginal likelihood of at most ``HYPER_ROWS`` rows; then the
posterior is exact on all rows. Memory grows with the square of the rows and time with their cube: at 20,000 rows, a
kernel matrix and its factors take 3.2 GB each.
"""

from __future__ import annotations

import warnings

import numpy as np
import torch
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from torch import Tensor

from cmbrl.data.transitions import Transitions
from cmbrl.models.manifold import Coordinates, invariant_translations
from cmbrl.scene import Scene

HYPER_ROWS = 300
CHUNK = 512  # rows predicted at once, to bound memory


class GaussianProcess:
    """q' = q (+) dq, v' = v + dv with (dq, dv) the posterior mean at the standardised (q, v, u)."""

    name = "Gaussian process"

    def __init__(self, scene: Scene, data: Transitions, seed: int = 0) -> None:
        """Learns from ``data``; ``seed`` draws the rows for the hyperparameters."""
        self.dt = data.dt
        self._coordinates = Coordinates.from_scene(scene)
        dropped = invariant_translations(scene)
        self._kept = [a for a in range(scene.nq) if a not in dropped]
        inputs = self._features(data.q, data.v, data.u)
        targets = np.hstack([scene.difference(data.q, data.q_next), data.v_next - data.v])
        self._mean, self._scale = inputs.mean(axis=0), _deviation(inputs)
        self._target_mean, self._target_scale = targets.mean(axis=0), _deviation(targets)
        inputs = (inputs - self._mean) / self._scale
        targets = (targets - self._target_mean) / self._target_scale
        some = np.random.default_rng(seed).permutation(len(data))[:HYPER_ROWS]
        kernel = ConstantKernel(10.0, (1e-2, 1e5)) * RBF(np.full(inputs.shape[1], 5.0), (0.1, 1e4))
        kernel += WhiteKernel(1e-2, (1e-8, 1e1))
        self.processes = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # irrelevant inputs drive length scales to a bound
            for column in targets.T:
                found = GaussianProcessRegressor(kernel, random_state=seed).fit(inputs[some], column[some])
                self.processes.append(GaussianProcessRegressor(found.kernel_, optimizer=None).fit(inputs, column))

    def _features(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.hstack([q[:, self._kept], v, u])

    def step(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv), float64."""
        inputs = (self._features(q.numpy(), v.numpy(), u.numpy()) - self._mean) / self._scale
        # Diverged states stay so; scikit-learn raises an error for a NaN.
        finite = np.isfinite(inputs).all(axis=1)
        predicted = np.full((len(inputs), len(self._target_mean)), np.nan)
        for rows in np.array_split(np.flatnonzero(finite), -(-int(finite.sum()) // CHUNK) or 1):
            if len(rows):
                predicted[rows] = np.stack([p.predict(inputs[rows]) for p in self.processes], axis=1)
        change = torch.as_tensor(self._target_mean + self._target_scale * predicted)
        nv = v.shape[1]
        return self._coordinates.integrate(q, change[:, :nv]), v + change[:, nv:]


def _deviation(columns: np.ndarray) -> np.ndarray:
    deviation = columns.std(axis=0)
    return np.where(deviation < 1e-12, 1.0, deviation)
