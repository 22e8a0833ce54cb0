"""What of the residuals of a fit a change of its model would explain, beyond what its parameters could.

A model that lacks something is fitted all the same: its parameters make up for a part. So a change of the model (play
at a joint, a finer time step) is not judged at the fit as it is. Its trace, the change of all predictions, is one more
column beside the derivatives in all parameters that were fitted:

    residual + J dz + sum_k c_k trace_k  ->  least squares, with the prior on dz

That is a score test (Rao 1948), by halves: dz and c come from one half of the log, what is left from the other. A
change that is there lowers what is left, and its c is about 1, since a trace is no derivative but the change itself.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.fitting.search.linearised import Lineariser
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.search.loss_values import ALIKE
from cmbrl.fitting.search.space import Space

_BLOCKS = 8  # of the log, of which every other one is of one half
_LINEAR = 1.5  # root mean squares of a coordinate's residual, from which residuals count linearly
_CHAOS = 1e6  # derivatives beyond which a window tells of no place but its own
_NUMBERS = 2_000_000  # doubles of the Jacobian in memory at once
_TINY = 1e-12


@dataclass(frozen=True)
class Unexplained:
    """Products (2, n + k + 1, n + k + 1) by halves of: n derivatives, the k traces called ``names``, and residuals."""

    products: np.ndarray
    precision: np.ndarray  #: (n, n) of the prior of the parameters
    names: tuple[Hashable, ...]

    @classmethod
    def of(
        cls,
        loss: PredictionLoss,
        space: Space,
        z: np.ndarray,
        active: np.ndarray,
        changes: Mapping[Any, tuple[PredictionLoss, np.ndarray]],
    ) -> Unexplained:
        """At ``z`` (n,), of whose parameters the ``active`` (n,) ones were fitted.

        ``changes``: by name, the same windows under a changed model, and its parameters.
        """
        own = loss.residuals(space.theta(z))[0]
        traces = [other.residuals(theta)[0] - own for other, theta in changes.values()]
        finite = np.isfinite(np.stack([own, *traces])).all(axis=(0, 2, 3))
        units = np.maximum(np.sqrt(np.square(own[finite]).mean(axis=(0, 1))), _TINY)
        scaled = np.stack([*traces, -own], axis=-1) / units[:, None]
        half = (np.argsort(np.argsort(loss.windows.starts)) * _BLOCKS // len(own)) % 2
        columns = np.flatnonzero(active)
        lineariser, by_z = loss.lineariser(space.theta(z), columns), space.slope(z)[columns]
        width = len(columns) + scaled.shape[-1]
        products, size = np.zeros((2, width, width)), max(1, _NUMBERS // (own[0].size * width))
        for i in range(0, len(own), size):
            part = slice(i, i + size)
            slopes = _slopes(lineariser, part, by_z).reshape(*own[part].shape, -1)
            told = finite[part] & (np.abs(slopes).max(axis=(1, 2, 3), initial=0.0) < _CHAOS)  # not if NaN
            rows = np.concatenate([slopes / units[:, None], scaled[part]], axis=-1)
            rows *= np.sqrt(np.minimum(1.0, _LINEAR / np.maximum(np.abs(rows[..., -1:]), _TINY)))
            for which in range(2):
                some = rows[told & (half[part] == which)].reshape(-1, width)
                products[which] += some.T @ some
        return cls(products, space.precision[np.ix_(columns, columns)], tuple(changes))

    def left(self, names: Sequence[Hashable]) -> tuple[float, np.ndarray]:
        """Squares of residuals that are left beside the traces ``names``, on unseen halves, and c (2, len(names))."""
        n = len(self.precision)
        columns = [*range(n), *(n + self.names.index(name) for name in names)]
        total, found = 0.0, []
        for seen, unseen in zip(self.products, self.products[::-1], strict=True):
            system = seen[np.ix_(columns, columns)]
            system[:n, :n] += ALIKE * self.precision
            system[np.diag_indices(len(system))] += _TINY * np.trace(system) + _TINY
            x = np.linalg.solve(system, seen[columns, -1])
            total += float(unseen[-1, -1] - 2.0 * x @ unseen[columns, -1] + x @ unseen[np.ix_(columns, columns)] @ x)
            found.append(x[n:])
        return total, np.array(found)


def _slopes(lineariser: Lineariser, part: slice, by_z: np.ndarray) -> np.ndarray:
    """Derivatives (s, w, n) of the windows in ``part`` in z, whose parameters have slopes ``by_z`` (n,)."""
    found = lineariser.at(part)
    slopes = np.zeros((*found.residual.shape, len(by_z)))
    slopes[:, :, found.told] = np.moveaxis(found.jacobian * by_z[found.told, None], 1, -1)
    return slopes
