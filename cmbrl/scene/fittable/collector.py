"""Collects the parameters of a scene and their columns in the physical vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.records import Array, Parameter

Places = NDArray[np.int64] | Sequence[int] | range  # offsets into P

_SHARES = ("impedance_low", "impedance_high")  # between 0 and 1, searched on a logit scale


@dataclass(frozen=True)
class Moves:
    """Parameters and their columns D, compressed: entries ptr[k]:ptr[k+1] of idx and coef belong to parameter k."""

    parameters: tuple[Parameter, ...]
    ptr: np.ndarray
    idx: np.ndarray
    coef: Array


class Collector:
    """Gathers parameters, each with the places of P that it moves."""

    def __init__(self) -> None:
        self.parameters: list[Parameter] = []
        self.places: list[NDArray[np.int32]] = []
        self.coefs: list[Array] = []

    def add(
        self,
        group: str,
        of: str,
        value: float,
        low: float,
        high: float,
        unit: str,
        places: Places,
        coefs: float | Array = 1.0,
        default: bool = True,
        reach: float = 1.0,
    ) -> int:
        """Adds a parameter that moves these places of P; returns its number.

        Its transform is "log" for positive bounds, "logit" for impedances, otherwise "linear". ``low`` and ``high``:
        what is expected; the bounds are ``reach`` times as far from ``value`` in the coordinate of the transform.
        """
        name = f"{group}.{of}" if of else group
        transform = "linear" if low <= 0 else "logit" if group in _SHARES else "log"
        if reach != 1.0:
            low, high = (_further(value, bound, reach, transform) for bound in (low, high))
        self.parameters.append(Parameter(name, group, value, low, high, transform, unit, default, reach))
        self.places.append(np.asarray(places, dtype=np.int32))
        self.coefs.append(np.full(len(places), 1.0) * coefs)
        return len(self.parameters) - 1

    def scale(
        self, group: str, of: str, low: float, high: float, P: Array, places: Places, default: bool = True,
        reach: float = 1.0,
    ) -> int:  # fmt: skip
        """Adds a factor on these places of P."""
        return self.add(group, of, 1.0, low, high, "1", places, P[np.asarray(places)], default, reach)

    def moves(self) -> Moves:
        """All parameters, compressed."""
        return Moves(
            tuple(self.parameters),
            np.cumsum([0, *map(len, self.places)]).astype(np.int32),
            np.concatenate([np.zeros(0, np.int32), *self.places]),
            np.concatenate([np.zeros(0), *self.coefs]),
        )


def _further(value: float, bound: float, reach: float, transform: str) -> float:
    """The bound ``reach`` times as far from ``value``."""
    return value * (bound / value) ** reach if transform == "log" else value + reach * (bound - value)
