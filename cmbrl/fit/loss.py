"""How wrong a parameter set is: Huberised prediction errors relative to how much each coordinate changes.

    L(theta) = mean over starts s and steps j of  sum_c rho(r_sjc),   r = (predicted - logged) / scale_c
    rho(r) = r^2 / 2 for |r| <= delta, delta (|r| - delta / 2) beyond

scale_c is the standard deviation of the logged one-step change of coordinate c (positions in the tangent space, [m] or
[rad]; velocities [m/s] or [rad/s]), so an error of 1 is as bad as predicting the mean change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

_ROWS_AT_ONCE = 4_000_000  # candidate x transition products in one native call: a few seconds, so that Ctrl-C is heard
_JACOBIAN_NUMBERS = 4_000_000  # doubles of parameter Jacobian in memory at once (32 MB)
FAILED = 2  # status of a step that did not converge
_SCALE_FLOOR = 1e-3  # of the largest scale of its kind: a coordinate that hardly moves must not rule the loss


@dataclass(frozen=True)
class Scales:
    """Standard deviation of the logged change, q (nv,) in tangent space and v (nv,); and delta of the Huber loss."""

    q: np.ndarray
    v: np.ndarray
    huber: float

    @classmethod
    def of(cls, scene: Any, data: Any, huber: float) -> Scales:
        return cls(_spread(scene.difference(data.q, data.q_next)), _spread(data.v_next - data.v), huber)


def _spread(change: np.ndarray) -> np.ndarray:
    spread = change.std(axis=0)
    return np.maximum(spread, max(_SCALE_FLOOR * spread.max(), 1e-9))


def huber(residual: np.ndarray, delta: float) -> np.ndarray:
    """rho(r), elementwise."""
    size = np.abs(residual)
    return np.where(size <= delta, 0.5 * residual**2, delta * (size - 0.5 * delta))


@dataclass(frozen=True)
class Errors:
    """One parameter set, start by start: ``loss`` (n,), mean ``squares`` (n,) of residuals; how many steps failed."""

    loss: np.ndarray
    squares: np.ndarray
    failures: int

    @property
    def mean(self) -> float:
        return float(self.loss.mean())

    @property
    def rmse(self) -> float:
        """Root mean square of the normalised residuals over all coordinates."""
        return float(np.sqrt(self.squares.mean()))


@dataclass(frozen=True)
class NormalEquations:
    """Gauss-Newton model of the loss in z: gradient (n,), its parts by episode (episodes, n), hessian (n, n).

    ``starts`` is the number of residual vectors, ``variance`` the mean of the Huberised squared residuals.
    """

    gradient: np.ndarray
    hessian: np.ndarray
    episode_gradients: np.ndarray
    starts: int
    variance: float


class PredictionLoss:
    """The loss on chosen ``starts`` (rows from which ``horizon`` steps are predicted open loop)."""

    def __init__(self, model: Any, data: Any, starts: np.ndarray, horizon: int, scales: Scales) -> None:
        self.model, self.data, self.horizon, self.scales = model, data, horizon, scales
        self.starts = np.ascontiguousarray(starts, dtype=np.int64)

    def on(self, starts: np.ndarray) -> PredictionLoss:
        """The same loss on other ``starts``."""
        return PredictionLoss(self.model, self.data, starts, self.horizon, self.scales)

    def values(self, theta: np.ndarray) -> np.ndarray:
        """Loss of candidates, (C, n) -> (C,): candidates x transitions in one native batch, cut to stay responsive."""
        data, scales = self.data, self.scales
        block = max(1, _ROWS_AT_ONCE // (len(self.starts) * self.horizon))
        parts = [
            self.model.candidate_loss(
                q=data.q,
                v=data.v,
                u=data.u,
                q_next=data.q_next,
                v_next=data.v_next,
                starts=self.starts,
                horizon=self.horizon,
                theta=np.ascontiguousarray(theta[i : i + block]),
                scale_q=scales.q,
                scale_v=scales.v,
                huber=scales.huber,
            )
            for i in range(0, len(theta), block)
        ]
        return np.concatenate(parts)

    def errors(self, theta: np.ndarray) -> Errors:
        """Errors of one parameter set (n,), start by start; a failed step counts as what its best iterate gives."""
        residual, failures = self._residual(theta, self.starts)
        loss = huber(residual, self.scales.huber).sum(axis=2).mean(axis=1)
        return Errors(loss, (residual**2).mean(axis=(1, 2)), failures)

    def normal_equations(self, space: Any, z: np.ndarray, active: np.ndarray | None = None) -> NormalEquations:
        """The Gauss-Newton model at ``z`` from the implicit derivatives of the step.

        It is over all parameters, or over the ``active`` (n,) ones, with zeros for the others.
        """
        columns = np.arange(len(space)) if active is None else np.flatnonzero(active)
        n, episodes = len(columns), np.unique(self.data.episode)
        gradients, hessian, size = np.zeros((len(episodes), n)), np.zeros((n, n)), 0.0
        width = 2 * len(self.scales.v) * self.horizon
        block = max(1, _JACOBIAN_NUMBERS // (width * max(n, 1)))
        for i in range(0, len(self.starts), block):
            starts = self.starts[i : i + block]
            residual, jacobian = self._linearised(space, z, starts, columns)  # (s, width), (s, width, n)
            weight = np.minimum(1.0, self.scales.huber / np.maximum(np.abs(residual), 1e-300))
            slopes = ((weight * residual)[:, None] @ jacobian)[:, 0]
            np.add.at(gradients, np.searchsorted(episodes, self.data.episode[starts]), slopes)
            rows = (np.sqrt(weight)[:, :, None] * jacobian).reshape(-1, n)
            hessian += rows.T @ rows
            size += float((weight * residual**2).sum())
        count = len(self.starts) * self.horizon
        by_episode, square = np.zeros((len(episodes), len(space))), np.zeros((len(space), len(space)))
        by_episode[:, columns], square[np.ix_(columns, columns)] = gradients / count, hessian / count
        return NormalEquations(by_episode.sum(axis=0), square, by_episode, count, size / (len(self.starts) * width))

    def _residual(self, theta: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, int]:
        """Residuals (s, horizon, 2 nv) of one parameter set (n,) or of one per start (s, n), and failed steps."""
        data, scene = self.data, self.model.scene
        q, v = data.q[starts], data.v[starts]
        out = np.empty((len(starts), self.horizon, 2 * len(self.scales.v)))
        failures = 0
        for j in range(self.horizon):
            step = self.model.predict(q, v, data.u[starts + j], theta=theta)
            q, v = step.q_next, step.v_next
            failures += int(np.count_nonzero(step.status == FAILED))
            out[:, j] = self._scaled(scene.difference(data.q_next[starts + j], q), v - data.v_next[starts + j])
        return out, failures

    def _linearised(
        self, space: Any, z: np.ndarray, starts: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (s, width), and their derivatives in the ``columns`` (n,) of z by the chain rule (s, width, n)."""
        data, scene, nv = self.data, self.model.scene, len(self.scales.v)
        q, v = data.q[starts], data.v[starts]
        residuals, jacobians, state = [], [], None
        for j in range(self.horizon):
            step = self.model.predict(q, v, data.u[starts + j], theta=space.theta(z), parameter_jacobian=True)
            q, v = step.q_next, step.v_next
            direct = step.jacobian[:, :, 2 * nv + scene.nu + columns]
            state = direct if state is None else step.jacobian[:, :, : 2 * nv] @ state + direct
            logged = data.q_next[starts + j], data.v_next[starts + j]
            residuals.append(self._scaled(scene.difference(logged[0], q), v - logged[1]))
            # The tangent of the prediction stands for that of the difference: equal for small rotation errors.
            jacobians.append(state / np.concatenate([self.scales.q, self.scales.v])[:, None])
        return np.concatenate(residuals, axis=1), np.concatenate(jacobians, axis=1) * space.slope(z)[columns]

    def _scaled(self, dq: np.ndarray, dv: np.ndarray) -> np.ndarray:
        return np.concatenate([dq / self.scales.q, dv / self.scales.v], axis=-1)
