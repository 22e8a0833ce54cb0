"""The loss of a parameter set: Huberised prediction errors, relative to how much each coordinate changes.

    L(theta) = mean over starts s and steps j of  sum_c rho(r_sjc),   r = (predicted - logged) / scale_c
    rho(r) = r^2 / 2 for |r| <= delta, delta (|r| - delta / 2) beyond

scale_c is the standard deviation of the logged one-step change of coordinate c (positions in the tangent space, [m] or
[rad]; velocities [m/s] or [rad/s]), so an error of 1 is that of predicting the mean change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbrl.fitting.space import Space
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Windows
from cmbrl.native import SolverStatus

_ROWS_AT_ONCE = 4_000_000  # candidates x transitions in one native call: a few seconds, so that Ctrl-C works
_JACOBIAN_NUMBERS = 4_000_000  # doubles of the parameter Jacobian in memory at once (32 MB)


def huber(residual: np.ndarray, delta: float) -> np.ndarray:
    """rho(r), elementwise."""
    size = np.abs(residual)
    return np.where(size <= delta, 0.5 * residual**2, delta * (size - 0.5 * delta))


@dataclass(frozen=True)
class Errors:
    """Errors of one parameter set: ``loss`` (n,) and mean ``squares`` (n,) of residuals by start; failed steps."""

    loss: np.ndarray
    squares: np.ndarray
    failures: int

    @property
    def mean(self) -> float:
        """Mean loss."""
        return float(self.loss.mean())

    @property
    def rmse(self) -> float:
        """Root mean square of the normalised residuals over all coordinates."""
        return float(np.sqrt(self.squares.mean()))


@dataclass(frozen=True)
class NormalEquations:
    """Gauss-Newton model of the loss in z: gradient (n,), its parts by episode (episodes, n), and hessian (n, n).

    ``starts`` is the number of residual vectors, ``variance`` the mean Huberised squared residual.
    """

    gradient: np.ndarray
    hessian: np.ndarray
    episode_gradients: np.ndarray
    starts: int
    variance: float


@dataclass(frozen=True)
class PredictionLoss:
    """The loss of parameters of ``model`` over ``windows`` of a log."""

    model: ComplementarityModel
    windows: Windows

    def on(self, starts: np.ndarray) -> PredictionLoss:
        """The same loss over the windows from other ``starts``."""
        return PredictionLoss(self.model, self.windows.on(starts))

    @property
    def steps(self) -> int:
        """Predicted transitions."""
        return len(self.windows.starts) * self.windows.horizon

    def values(self, theta: np.ndarray) -> np.ndarray:
        """Losses (C,) of candidates (C, n), in native batches small enough to stay responsive."""
        block = max(1, _ROWS_AT_ONCE // self.steps)
        blocks = range(0, len(theta), block)
        return np.concatenate([self.model.candidate_loss(theta[i : i + block], self.windows) for i in blocks])

    def errors(self, theta: np.ndarray) -> Errors:
        """Errors of one parameter set (n,) by start; a failed step counts with its best iterate."""
        residual, failures = self._residual(theta)
        loss = huber(residual, self.windows.scales.huber).sum(axis=2).mean(axis=1)
        return Errors(loss, (residual**2).mean(axis=(1, 2)), failures)

    def normal_equations(self, space: Space, z: np.ndarray, active: np.ndarray | None = None) -> NormalEquations:
        """The Gauss-Newton model at ``z`` (n,), from the implicit derivatives of the step.

        ``active`` (n,): parameters to differentiate by; the others get zeros. Default: all.
        """
        data, scales, all_starts = self.windows.data, self.windows.scales, self.windows.starts
        columns = np.arange(len(space)) if active is None else np.flatnonzero(active)
        n, episodes = len(columns), np.unique(data.episode)
        gradients, hessian, size = np.zeros((len(episodes), n)), np.zeros((n, n)), 0.0
        width = 2 * len(scales.v) * self.windows.horizon
        block = max(1, _JACOBIAN_NUMBERS // (width * max(n, 1)))
        for i in range(0, len(all_starts), block):
            starts = all_starts[i : i + block]
            residual, jacobian = self._linearised(space, z, starts, columns)  # (s, width), (s, width, n)
            lost = ~(np.isfinite(residual).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2)))
            residual[lost], jacobian[lost] = 0.0, 0.0  # failed steps: a constant in the loss, which has no slope
            weight = np.minimum(1.0, scales.huber / np.maximum(np.abs(residual), 1e-300))
            slopes = ((weight * residual)[:, None] @ jacobian)[:, 0]
            np.add.at(gradients, np.searchsorted(episodes, data.episode[starts]), slopes)
            rows = (np.sqrt(weight)[:, :, None] * jacobian).reshape(-1, n)
            hessian += rows.T @ rows
            size += float((weight * residual**2).sum())
        count = self.steps
        by_episode, square = np.zeros((len(episodes), len(space))), np.zeros((len(space), len(space)))
        by_episode[:, columns], square[np.ix_(columns, columns)] = gradients / count, hessian / count
        return NormalEquations(by_episode.sum(axis=0), square, by_episode, count, size / (len(all_starts) * width))

    def _residual(self, theta: np.ndarray) -> tuple[np.ndarray, int]:
        """Residuals (s, horizon, 2 nv) of one parameter set (n,), and the number of failed steps."""
        data, starts, scene = self.windows.data, self.windows.starts, self.model.scene
        q, v = data.q[starts], data.v[starts]
        out = np.empty((len(starts), self.windows.horizon, 2 * scene.nv))
        failures = 0
        for j in range(self.windows.horizon):
            step = self.model.predict(q, v, data.u[starts + j], theta=theta)
            q, v = step.q_next, step.v_next
            failures += int(np.count_nonzero(step.status == SolverStatus.FAILED))
            out[:, j] = self._scaled(scene.difference(data.q_next[starts + j], q), v - data.v_next[starts + j])
        return out, failures

    def _linearised(
        self, space: Space, z: np.ndarray, starts: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (s, width) and their derivatives (s, width, n) in the ``columns`` (n,) of z, by the chain rule."""
        data, scales, scene, nv = self.windows.data, self.windows.scales, self.model.scene, self.model.scene.nv
        q, v = data.q[starts], data.v[starts]
        residuals, jacobians, state = [], [], None
        for j in range(self.windows.horizon):
            step = self.model.predict(q, v, data.u[starts + j], theta=space.theta(z), parameter_jacobian=True)
            q, v = step.q_next, step.v_next
            assert step.jacobian is not None
            direct = step.jacobian[:, :, 2 * nv + scene.nu + columns]
            state = direct if state is None else step.jacobian[:, :, : 2 * nv] @ state + direct
            logged = data.q_next[starts + j], data.v_next[starts + j]
            residuals.append(self._scaled(scene.difference(logged[0], q), v - logged[1]))
            # The tangent of the prediction replaces that of the difference; they are equal for small rotation errors.
            jacobians.append(state / np.concatenate([scales.q, scales.v])[:, None])
        return np.concatenate(residuals, axis=1), np.concatenate(jacobians, axis=1) * space.slope(z)[columns]

    def _scaled(self, dq: np.ndarray, dv: np.ndarray) -> np.ndarray:
        return np.concatenate([dq / self.windows.scales.q, dv / self.windows.scales.v], axis=-1)
