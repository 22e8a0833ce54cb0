"""Open-loop predictions of windows with their derivatives, by the chain rule along each window.

The core carries the tangents along. A window touches few of the contacts that a robot could have, so most columns of
its parameters are zero throughout; they are left out here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.models.between.observation import Observation
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.log_windows import Predicted
from cmbrl.models.windows import Windows


@dataclass(frozen=True)
class Linearised:
    """``residual`` (s, w) of windows, with derivatives in parameters, ``jacobian`` (s, t, w), and in the starts.

    w: steps, and the coordinates that count in each. ``told`` (t,): which of the columns asked for are not zero
    throughout. ``slope`` (s, w, k): in the uncertain coordinates of the starts.
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
        self.of_model = np.ascontiguousarray(columns[columns < len(self.physical)], dtype=np.int64)
        self.of_log, own = observation.columns(columns, len(self.physical))
        data, rows, nv = windows.data, windows.rows, model.scene.nv  # a long log has many that no window covers
        self.seen = windows.on_rows(observation.states(data, psi, rows))
        self.bias = observation.state_slope(nv)[:, own]  # of the state that the log tells
        none = np.zeros((*self.seen.data.u.shape, 0))
        driven = observation.controls(data, psi, rows, own)[1][:, :, own] if len(own) else none
        self.driven = np.ascontiguousarray(driven)
        self.uncertain = len(windows.scales.uncertain)
        self.begun = np.hstack([np.eye(2 * nv)[:, windows.scales.uncertain], self.bias])

    def at(self, part: slice = slice(None)) -> Linearised:
        """Those windows in ``part``."""
        counts, own = self.windows.scales.counts, len(self.of_log)
        units = self.windows.units[part if self.windows.own else slice(None)][:, counts]
        found = self.model.along(
            self.seen.some(part), self.physical, self.of_model, self.begun, self.driven, np.flatnonzero(counts), units
        )
        jacobian, told = found.tangents[:, self.uncertain :], np.concatenate([self.of_log, found.told])
        # The tangent of the prediction replaces that of the difference; they are equal for small rotation errors.
        jacobian[:, :own] -= (self.bias[counts].T / units[:, None])[:, :, None]
        if twice := np.flatnonzero(np.isin(self.of_log, found.told)).tolist():  # of activations, and of steps
            for k in twice:
                jacobian[:, own + int(np.flatnonzero(found.told == self.of_log[k])[0])] += jacobian[:, k]
            jacobian, told = np.delete(jacobian, twice, axis=1), np.delete(told, twice)
        slope = np.moveaxis(found.tangents[:, : self.uncertain], 1, -1)
        residual = (self._off(found, part)[:, :, counts] / units[:, None]).reshape(len(jacobian), -1)
        jacobian = jacobian.reshape(*jacobian.shape[:2], residual.shape[1])
        return Linearised(residual, jacobian, told, slope.reshape(*residual.shape, self.uncertain))

    def _off(self, found: Predicted, part: slice) -> np.ndarray:
        """Predicted less logged states (s, steps, 2 nv)."""
        data, starts = self.seen.data, self.seen.starts[part]
        rows = starts[:, None] + np.arange(self.seen.horizon)
        return np.concatenate(
            [self.model.scene.difference(data.q_next[rows], found.q), found.v - data.v_next[rows]], axis=2
        )
