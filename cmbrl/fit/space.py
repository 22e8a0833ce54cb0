"""The space a fit searches: named physical parameters, bounded, each measured in widths of its prior.

A parameter ``theta`` of transform "log" is searched as ``t = log theta``, of transform "linear" as ``t = theta``.
Both are then written as ``z = (t - t_nominal) / sd`` with ``sd`` a sixth of the distance between the bounds in ``t``:
the bounds are three prior standard deviations either side where the nominal value lies midway. So z = 0 is what the
user believed, one unit of z is a plausible error of any parameter, and the prior is standard normal. The width is our
own choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean

_BOUNDS_WIDTH_IN_SD = 6.0


@dataclass(frozen=True)
class Space:
    """Parameters in the order of ``scene.parameters``; arrays have shape (n,), theta in the parameter's own unit."""

    names: tuple[str, ...]
    groups: tuple[str, ...]
    units: tuple[str, ...]
    nominal: np.ndarray
    low: np.ndarray
    high: np.ndarray
    log: np.ndarray
    sd: np.ndarray

    @classmethod
    def of(cls, parameters: Sequence[Any], theta: np.ndarray) -> Space:
        """The space of ``scene.parameters`` around ``theta`` (n,), which is the centre of the prior.

        Raises UserError when a value of ``theta`` lies outside its bounds.
        """
        nominal = np.array(theta, dtype=float)
        low = np.array([p.low for p in parameters], dtype=float)
        high = np.array([p.high for p in parameters], dtype=float)
        for p, value in zip(parameters, nominal, strict=True):
            if not p.low <= value <= p.high:
                raise UserError(
                    f"parameter {p.name} = {value:g} is outside its bounds [{p.low:g}, {p.high:g}]: change it"
                )
        log = np.array([p.transform == "log" for p in parameters], dtype=bool)
        sd = (_t(high, log) - _t(low, log)) / _BOUNDS_WIDTH_IN_SD
        names, groups, units = zip(*((p.name, p.group, p.unit) for p in parameters), strict=True)
        return cls(names, groups, units, nominal, low, high, log, sd)

    def __len__(self) -> int:
        return len(self.names)

    def theta(self, z: np.ndarray) -> np.ndarray:
        """Parameters (..., n) at ``z`` (..., n); exactly the nominal value at z = 0."""
        step = self.sd * z
        moved = np.where(self.log, self.nominal * np.exp(np.where(self.log, step, 0.0)), self.nominal + step)
        return np.clip(moved, self.low, self.high)

    def z(self, theta: np.ndarray) -> np.ndarray:
        """The inverse of ``theta``: (..., n) -> (..., n)."""
        return (_t(np.asarray(theta, dtype=float), self.log) - _t(self.nominal, self.log)) / self.sd

    @property
    def z_low(self) -> np.ndarray:
        return self.z(self.low)

    @property
    def z_high(self) -> np.ndarray:
        return self.z(self.high)

    def slope(self, z: np.ndarray) -> np.ndarray:
        """d theta / d z at ``z``, (n,)."""
        return np.where(self.log, self.theta(z), 1.0) * self.sd

    def at_bound(self, z: np.ndarray, tolerance: float = 1e-6) -> np.ndarray:
        """True (n,) where z is on a bound, to ``tolerance`` of the distance between the bounds.

        A parameter that starts on its bound and has not moved (no damping, no restitution) is not on it by the fit.
        """
        near = tolerance * _BOUNDS_WIDTH_IN_SD
        return ((z <= self.z_low + near) | (z >= self.z_high - near)) & (np.abs(z) > near)

    def columns(self, wanted: Iterable[str]) -> np.ndarray:
        """True (n,) for every parameter that ``wanted`` names, by its own name or by its group.

        Raises UserError on a name that is neither.
        """
        chosen = np.zeros(len(self), dtype=bool)
        for name in wanted:
            hit = np.array([name in (n, g) for n, g in zip(self.names, self.groups, strict=True)])
            if not hit.any():
                known = {*self.names, *self.groups}
                raise UserError(f"no parameter or group named {name!r} in this scene: {did_you_mean(name, known)}")
            chosen |= hit
        return chosen


def _t(theta: np.ndarray, log: np.ndarray) -> np.ndarray:
    return np.where(log, np.log(np.where(log, theta, 1.0)), theta)
