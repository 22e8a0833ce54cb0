"""Windows of a log step by step, with the product of the steps' Jacobians, which the core's tangents have to equal."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.models.log_windows import Predicted
from cmbrl.models.windows import Windows


def along_by_steps(
    model: Any, windows: Windows, theta: np.ndarray, columns: np.ndarray, begun: np.ndarray, driven: np.ndarray,
    rows: np.ndarray, units: np.ndarray,
) -> Predicted:  # fmt: skip
    """As ``LogWindows.along``, of any model with ``predict``."""
    (q, v), states, starts = windows.begin(model.scene), 2 * model.scene.nv, windows.starts
    of_log, own = driven.shape[2], begun.shape[1]
    tangent = np.zeros((len(q), states, own + len(columns)))
    tangent[:, :, :own] = begun
    places, speeds, tangents = [], [], []
    for j in range(windows.horizon):
        step = model.predict(q, v, windows.data.u[starts + j], theta, jacobian=True, parameter_jacobian=columns)
        by_state, by_input, by_theta = np.split(step.jacobian, [states, states + driven.shape[1]], axis=2)
        tangent = by_state @ tangent
        tangent[:, :, own - of_log : own] += by_input @ driven[starts + j]
        tangent[:, :, own:] += by_theta
        q, v = step.q_next, step.v_next
        places.append(q)
        speeds.append(v)
        tangents.append(tangent[:, rows])
    found = np.moveaxis(np.stack(tangents, axis=1), -1, 1)
    told = np.flatnonzero((found[:, own:] != 0.0).any(axis=(0, 2, 3)))
    kept = np.append(np.arange(own), own + told)
    return Predicted(np.stack(places, axis=1), np.stack(speeds, axis=1), found[:, kept] / units[:, None, None], told)
