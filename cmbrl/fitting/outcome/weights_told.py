"""What a log would leave open if rows told nothing of masses.

A row is as soft as an inverse weight says, which masses change by MuJoCo's law. What a robot touches is not softer for
lighter links, so intervals are at least as wide as where inverse weights are those of the fitted masses and no
parameter changes them; and they allow for the step to where the fit would go then.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbrl.fitting.outcome.identify import Identification
from cmbrl.fitting.search.loss_values import NormalEquations


def constant(weighed: NormalEquations, own: NormalEquations) -> NormalEquations:
    """The information of constant weights, ``weighed``, for residuals as large as the ``own``.

    Its own residuals are not those of the fit, nor are its scores: both count as none.
    """
    silent = {name: np.zeros_like(getattr(own, name)) for name in ("gradient", "episode_gradients")}
    return replace(weighed, independent=own.independent, variance=own.variance, **silent)


def beyond_weights(known: Identification, constant: Identification, step: np.ndarray) -> np.ndarray:
    """Covariance (n, n) in z that intervals lack: what ``constant`` weights leave open and ``known`` does not.

    And the ``step`` (n,) to where they would lead.
    """
    more = constant.apart - known.apart  # in one unit of force: how much that is open is known already
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    lacking: np.ndarray = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return lacking + np.outer(step, step)
