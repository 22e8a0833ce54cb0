"""Open-loop predictions of windows of a log in one native batch: losses of many candidates, or the tangents of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.models.native_step.stepper import Stepper
from cmbrl.models.windows import Windows
from cmbrl.numbers import real_array
from cmbrl.scene import Scene

FAILURE_LOSS = 1e3  # added to a candidate's loss by a failed solve


@dataclass(frozen=True)
class Predicted:
    """Windows as they are predicted: q (S, horizon, nq) and v (S, horizon, nv) after each step, and their tangents.

    ``tangents`` (S, c + t, horizon, r): in the c columns that the windows begin with, then in those parameters, of the
    ones asked for, that are not idle throughout: ``told`` (t,).
    """

    q: np.ndarray
    v: np.ndarray
    tangents: np.ndarray
    told: np.ndarray


class LogWindows:
    """What a model predicts of the windows of a log."""

    scene: Scene
    stepper: Stepper

    @property
    def lanes(self) -> int:
        """How many windows the core predicts as fast as one."""
        return self.stepper.core.width

    def candidate_losses(self, theta: np.ndarray, windows: Windows) -> np.ndarray:
        """Losses (C, S) of parameter candidates theta (C, np) by window, in one native batch.

        Every window is predicted open loop, from states of each candidate's own if ``windows`` have such. The Huber
        loss of (prediction - log) / scale is summed over coordinates and averaged over steps. A failed solve adds a
        large constant.
        """
        data, scales = windows.data, windows.scales
        q, v = windows.begin(self.scene)
        losses: np.ndarray = self.stepper.core.loss(
            q, v, data.u, data.q_next, data.v_next, windows.starts, windows.horizon,
            real_array(theta, "theta"), scales.q, scales.v, scales.huber, FAILURE_LOSS,
            self.stepper.options, self.stepper.threads,
        )  # fmt: skip
        return losses / windows.horizon

    def along(
        self, windows: Windows, theta: np.ndarray, columns: np.ndarray, begun: np.ndarray, driven: np.ndarray,
        rows: np.ndarray, units: np.ndarray,
    ) -> Predicted:  # fmt: skip
        """The windows at parameters theta (np,), with derivatives of those ``rows`` (r,) of their states (q, v).

        By the parameters ``columns`` (k,), and by columns of one's own: ``begun`` (2 nv, c) says how they move the
        starts, and ``driven`` (N, nu, d) how the last d of them move the controls of the log's rows. Tangent space
        for q, in ``units`` (1, r) or (S, r). Raises UserError for arrays that do not fit; a window is NaN from where
        its state is no longer finite.
        """
        q, v = (np.ascontiguousarray(x) for x in windows.begin(self.scene))
        found = self.stepper.core.windows(
            q, v, windows.data.u, windows.starts, windows.horizon, real_array(theta, "theta"), columns, begun, driven,
            rows, np.ascontiguousarray(units), self.stepper.options, self.stepper.threads,
        )  # fmt: skip
        return Predicted(found["q_next"], found["v_next"], found["tangents"], found["told"])
