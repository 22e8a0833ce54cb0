"""Open-loop predictions of windows with their derivatives, by the chain rule along each window.

A window touches few of the contacts that a robot could have, so most columns of its parameters are zero throughout.
They are found first and left out of the products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.observation import Observation
from cmbrl.models.step_result import StepResult
from cmbrl.models.windows import Windows


@dataclass(frozen=True)
class Linearised:
    """``residual`` (s, w) of windows, with derivatives in parameters, ``jacobian`` (s, w, t), and in the starts.

    ``told`` (t,): which of the columns asked for are not zero throughout. ``slope`` (s, w, k): in the uncertain
    coordinates of the starts.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    told: np.ndarray
    slope: np.ndarray


class Lineariser:
    """``windows`` at ``theta`` (np + n,), with derivatives in some of its ``columns`` (c,): some at a time."""

    def __init__(
        self,
        model: ComplementarityModel,
        observation: Observation,
        windows: Windows,
        theta: np.ndarray,
        columns: np.ndarray,
    ) -> None:
        self.model, self.windows = model, windows
        self.physical, psi = observation.split(theta)
        self.of_model = columns[columns < len(self.physical)]
        self.of_log, own = observation.columns(columns, len(self.physical))
        data, rows = windows.data, windows.rows  # a long log has many that no window covers
        self.seen = windows.on_rows(observation.states(data, psi, rows))
        self.bias = observation.state_slope(model.scene.nv)[:, own]  # of the state that the log tells
        self.controls = observation.controls(data, psi, rows)[1][:, :, own] if len(own) else None

    def at(self, part: slice = slice(None)) -> Linearised:
        """Those windows in ``part``."""
        nv, first = self.model.scene.nv, 2 * self.model.scene.nv + self.model.scene.inputs  # of the parameters' columns
        counts, uncertain = self.windows.scales.counts, self.windows.scales.uncertain
        starts, units = self.seen.starts[part], self.windows.units[part if self.windows.own else slice(None)]
        steps, off = _predicted(self.model, self.seen, part, self.physical, self.of_model)
        touched = _touched(steps, first)
        told = np.union1d(touched, self.of_log)
        model_columns, log_columns = np.searchsorted(told, touched), np.searchsorted(told, self.of_log)
        begun = np.append(log_columns, len(told) + np.arange(len(uncertain)))  # what the starts depend on
        start = np.concatenate([self.bias, np.eye(2 * nv)[:, uncertain]], axis=1)
        state = np.zeros((len(starts), 2 * nv, len(told) + len(uncertain)))
        slopes = np.empty((len(starts), len(steps), int(counts.sum()), state.shape[2]))
        for j, step in enumerate(steps):
            assert step.jacobian is not None
            if j == 0:
                state[:, :, begun] = step.jacobian[:, :, : 2 * nv] @ start
            else:
                state = step.jacobian[:, :, : 2 * nv] @ state
            state[:, :, model_columns] += step.jacobian[:, :, first + touched]
            if self.controls is not None:
                state[:, :, log_columns] += step.jacobian[:, :, 2 * nv : first] @ self.controls[starts + j]
            # The tangent of the prediction replaces that of the difference; they are equal for small rotation errors.
            np.divide(state[:, counts], units[:, counts, None], out=slopes[:, j])
            slopes[:, j][:, :, log_columns] -= (self.bias / units[:, :, None])[:, counts]
        residual = (off / units[:, None])[:, :, counts].reshape(len(starts), -1)
        slopes = slopes.reshape(*residual.shape, -1)
        return Linearised(residual, slopes[:, :, : len(told)], told, slopes[:, :, len(told) :])


def _predicted(
    model: ComplementarityModel, windows: Windows, part: slice, theta: np.ndarray, columns: np.ndarray
) -> tuple[list[StepResult], np.ndarray]:
    """The steps of the windows with their Jacobians, and predicted less logged states (s, steps, 2 nv)."""
    data, starts, scene = windows.data, windows.starts[part], model.scene
    q, v = (x[part] for x in windows.begin(scene))
    steps, places, speeds = [], [], []
    for j in range(windows.horizon):
        step = model.predict(q, v, data.u[starts + j], theta=theta, jacobian=True, parameter_jacobian=columns)
        q, v = step.q_next, step.v_next
        steps.append(step)
        places.append(q)
        speeds.append(v)
    rows = starts[:, None] + np.arange(windows.horizon)
    away = scene.difference(data.q_next[rows], np.stack(places, axis=1)), np.stack(speeds, axis=1) - data.v_next[rows]
    return steps, np.concatenate(away, axis=2)


def _touched(steps: Sequence[StepResult], first: int) -> np.ndarray:
    """Which columns of the Jacobians, counted from the ``first`` of a parameter, are not zero in all ``steps``."""
    columns = [step.jacobian[:, :, first:] for step in steps if step.jacobian is not None]
    return np.flatnonzero(np.any([(part != 0.0).any(axis=(0, 1)) for part in columns], axis=0))
