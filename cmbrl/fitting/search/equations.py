"""The Gauss-Newton model of a loss, summed over its windows, some at a time; their starts are eliminated.

Where a window may start away from the logged state, its best start follows the parameters. To first order that is what
its own equations say, so the start is solved for and the rest of the window's equations take what is left (a Schur
complement).
"""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.search.linearised import Linearised
from cmbrl.fitting.search.loss_values import NormalEquations, alike_rows
from cmbrl.fitting.search.square_root import Rows, add_squares, root_of
from cmbrl.fitting.search.starts import Follow, StartEquations
from cmbrl.models.windows import Windows, huber

_CHAOS = 1e6  # residuals by prior standard deviations, beyond which a derivative tells of no place but its own


class EquationSums:
    """Sums over ``windows`` of the equations in some ``columns`` (c,) of z (n,); see :class:`NormalEquations`.

    ``by_z`` (c,): derivatives of the parameters by z. ``rooted``: with the root of the hessian.
    """

    def __init__(self, windows: Windows, columns: np.ndarray, by_z: np.ndarray, n: int, rooted: bool) -> None:
        self.windows, self.columns, self.by_z, self.n, self.rooted = windows, columns, by_z, n, rooted
        self.episodes = np.unique(windows.blocks)
        self.gradients = np.zeros((len(self.episodes), len(columns)))
        self.hessian = np.zeros((len(columns), len(columns)))
        self.size = 0.0  # of the Huberised squared residuals
        self.rows, self.alike = Rows(n), list[float]()
        self.followed: list[Follow] = []

    def add(self, part: slice, found: Linearised) -> None:
        """Adds the windows in ``part``, as they were ``found``; their derivatives are spent."""
        scales = self.windows.scales
        residual, jacobian, told = found.residual, found.jacobian, found.told
        jacobian *= self.by_z[told, None]
        _silence(found)
        self.alike.append(alike_rows(residual.reshape(len(residual), self.windows.horizon, -1)))
        weight = np.minimum(1.0, scales.huber / np.maximum(np.abs(residual), 1e-300))
        loss = huber(residual, scales.huber).sum(axis=1) / self.windows.horizon
        price = np.broadcast_to(self.windows.price, len(self.windows.starts))
        counts = self.windows.weight(loss + price[part])
        slopes = (jacobian @ (weight * residual)[:, :, None])[:, :, 0]
        self.size += float((counts[:, None] * weight * residual**2).sum())
        if self.windows.offset is not None:
            slopes -= self._eliminate(part, found, weight, counts)
        jacobian *= np.sqrt(weight * counts[:, None])[:, None]  # from here on: rows that are squared
        add_squares(self.hessian, jacobian.reshape(*jacobian.shape[:2], self.windows.horizon, scales.observed), told)
        if self.rooted and self.windows.offset is None:
            for window in jacobian:
                self.rows.add(window.T, self.columns[told])
        place = np.searchsorted(self.episodes, self.windows.blocks[part])
        np.add.at(self.gradients, np.ix_(place, told), counts[:, None] * slopes)

    def _eliminate(self, part: slice, found: Linearised, weight: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Takes what the starts explain from the hessian; returns it (s, t) of the slopes of the windows."""
        assert self.windows.offset is not None
        offset, told = self.windows.offset[part], found.told
        precision = self.windows.start_precision[part if self.windows.own else slice(None)]
        starts = StartEquations.of(found.residual, weight, found.slope, offset, precision, self.windows.scales.huber)
        cross = (found.jacobian @ (weight[:, :, None] * found.slope)).transpose(0, 2, 1)  # (s, k, t)
        solved = starts.solve(np.concatenate([starts.gradient[:, :, None], cross], axis=2))
        counted = counts[:, None, None] * cross
        self.hessian[np.ix_(told, told)] -= np.tensordot(counted, solved[:, :, 1:], axes=([0, 1], [0, 1]))
        self.followed.append(Follow.of(-solved, self.columns[told], self.n))
        return np.asarray((solved[:, None, :, 0] @ cross)[:, 0])

    def means(self, independent: float) -> NormalEquations:
        """The model by transition, of all windows; ``independent`` observations are what they are worth.

        Its ``follow`` is what the equations of each start say, whether or not that lowers the loss.
        """
        count = len(self.windows.starts) * self.windows.horizon
        by_episode, square = np.zeros((len(self.episodes), self.n)), np.zeros((self.n, self.n))
        by_episode[:, self.columns] = self.gradients / count
        square[np.ix_(self.columns, self.columns)] = self.hessian / count
        variance = self.size / (count * self.windows.scales.observed)
        follow = Follow.joined(self.followed) if self.followed else None
        return NormalEquations(
            by_episode.sum(axis=0), square, by_episode, independent, variance, follow, self._root(square, count)
        )

    def _root(self, square: np.ndarray, count: int) -> np.ndarray | None:
        if not self.rooted:
            return None
        return root_of(square) if self.windows.offset is not None else self.rows.root() / np.sqrt(count)


def _silence(found: Linearised) -> None:
    """Failed steps and chaos become a constant in the loss, which has no slope."""
    residual, jacobian, slope = found.residual, found.jacobian, found.slope
    lost = ~(np.isfinite(residual).all(axis=1) & np.isfinite(slope).all(axis=(1, 2)))
    lost |= ~(jacobian.max(axis=(1, 2), initial=0.0) <= _CHAOS)  # also where it is not finite
    lost |= ~(jacobian.min(axis=(1, 2), initial=0.0) >= -_CHAOS)
    residual[lost], jacobian[lost], slope[lost] = 0.0, 0.0, 0.0
