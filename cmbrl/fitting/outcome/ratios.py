"""Ratios of masses and forces, which motion tells better than their sizes.

Of parameters that are known up to a common factor, one is taken for right; the others follow in its unit, with
intervals that no longer hold the factor's. The reference is the one that leaves the others the narrowest intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.fitting.search.space import Space

_NORMAL_95 = 1.96
_NARROWER = 0.8  # than the parameter's own interval, on a logarithmic scale: else the ratio says nothing new


def moved_and_still(theta: np.ndarray, active: np.ndarray, together: Sequence[int]) -> tuple[list[int], list[int]]:
    """Columns of a common factor that a fit moved, and those that kept the file's values and tell the unit of force.

    What is 0, such as a friction loss that the file does not have, tells none.
    """
    moved = [k for k in together if active[k]]
    return moved, [k for k in together if not active[k] and theta[k] != 0.0]


def ratios(space: Space, z: np.ndarray, covariance: np.ndarray, together: Sequence[int]) -> dict[str, Any] | None:
    """Values of ``together``, columns of a common factor, if one of them has the file's value.

    ``covariance`` (n, n) in z. Returns {"reference", "parameters": {name: [value, low, high]}} of those that are better
    known so than alone, or None.
    """
    columns = [k for k in together if space.transform[k] == "log" and covariance[k, k] > 0.0]
    if len(columns) < 2:
        return None
    sd = space.sd[columns]
    logs = covariance[np.ix_(columns, columns)] * np.outer(sd, sd)
    alone = np.sqrt(np.diag(logs))
    own = np.diag(logs)
    apart = np.sqrt(np.maximum(own[:, None] + own[None] - 2.0 * logs, 0.0))  # of the ratios
    reference = int(np.argmin(np.minimum(apart, alone).sum(axis=1)))
    theta, first = space.theta(z), columns[reference]
    found = {}
    for k, column in enumerate(columns):
        if k != reference and apart[reference, k] < _NARROWER * alone[k]:
            value = float(theta[column] * space.nominal[first] / theta[first])
            factor = float(np.exp(_NORMAL_95 * apart[reference, k]))
            found[space.names[column]] = [value, value / factor, value * factor]
    return {"reference": space.names[first], "parameters": found} if found else None


def beside(
    space: Space, z: np.ndarray, covariance: np.ndarray, wide: np.ndarray, moved: Sequence[int], still: Sequence[int]
) -> dict[str, Any] | None:
    """The same of the columns ``moved`` where ``still``, of the same common factor, kept the file's values.

    All of these are then taken for right: ``held``. ``covariance`` (n, n) in z as long as they are; ``wide`` (n, n): in
    any unit of force.
    """
    theta, found = space.theta(z), {}
    for column in moved:
        apart, alone = np.sqrt([covariance[column, column], wide[column, column]])
        if space.transform[column] == "log" and 0.0 < apart < _NARROWER * alone:
            value, factor = float(theta[column]), float(np.exp(_NORMAL_95 * apart * space.sd[column]))
            found[space.names[column]] = [value, value / factor, value * factor]
    held = [space.names[k] for k in still]
    return {"reference": held[0], "held": held, "parameters": found} if found else None
