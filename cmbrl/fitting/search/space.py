"""The search space of a fit: named, bounded physical parameters in standard deviations of their priors.

A parameter ``theta`` is searched as ``t = log theta`` (transform "log"), ``t = log(theta / (1 - theta))`` ("logit", for
shares between 0 and 1) or ``t = theta`` ("linear"), written as ``z = (t - t_nominal) / sd``. ``sd`` is a sixth of the
distance between the bounds in ``t``, so bounds around a central nominal value are three standard deviations away, and
``reach`` times as far where a parameter may be far beyond what is expected. Thus z = 0 is the user's belief and a unit
of z is a plausible error. The prior is normal with unit variances. Joints, servos and contacts to which the file gives
the same value are believed alike, hence correlated: a log that says little about one of four legs says it by the other
three, and one in which only feet touch the floor says something about knees. Widths and correlation are our choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.scene import Parameter

_BOUNDS_WIDTH_IN_SD = 6.0
_ALIKE = (
    *("damping", "armature", "stiffness", "frictionloss", "kp", "kd", "kv"),
    *("friction", "softness_time", "softness_damping", "softness_scale"),
    *("impedance_low", "impedance_high", "impedance_width"),
)
_CORRELATION = 0.8  # of what is alike: each deviates from what is shared by 0.45 prior standard deviations


@dataclass(frozen=True)
class Space:
    """Named parameters; arrays are (n,), theta in the parameter's own unit, ``precision`` (n, n) of the prior in z.

    ``default`` (n,) bool: those that a fit may move without being asked by name.
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    units: tuple[str, ...]
    nominal: np.ndarray
    low: np.ndarray
    high: np.ndarray
    transform: np.ndarray
    sd: np.ndarray
    precision: np.ndarray
    default: np.ndarray

    @classmethod
    def of(cls, parameters: Sequence[Parameter], theta: np.ndarray) -> Space:
        """The space of ``parameters`` around ``theta`` (n,), the centre of the prior.

        Raises UserError if a value of ``theta`` is outside its bounds.
        """
        nominal = np.array(theta, dtype=float)
        low = np.array([p.low for p in parameters], dtype=float)
        high = np.array([p.high for p in parameters], dtype=float)
        for p, value in zip(parameters, nominal, strict=True):
            if not p.low <= value <= p.high:
                raise UserError(f"parameter {p.name} = {value:g} is outside its bounds [{p.low:g}, {p.high:g}]")
        transform = np.array([p.transform for p in parameters])
        reach = np.array([p.reach for p in parameters], dtype=float)
        sd = (_t(high, transform) - _t(low, transform)) / (_BOUNDS_WIDTH_IN_SD * reach)
        names, groups, units = zip(*((p.name, p.group, p.unit) for p in parameters), strict=True)
        default = np.array([p.default for p in parameters])
        return cls(names, groups, units, nominal, low, high, transform, sd, _precision(groups, nominal), default)

    def __len__(self) -> int:
        return len(self.names)

    def theta(self, z: np.ndarray) -> np.ndarray:
        """Parameters (..., n) at ``z`` (..., n); exactly nominal at z = 0."""
        step = self.sd * z
        linear, logit = self.transform == "linear", self.transform == "logit"
        factor = np.exp(np.where(linear, 0.0, step))  # of theta, or of theta / (1 - theta)
        scaled = self.nominal * factor / np.where(logit, 1.0 + self.nominal * (factor - 1.0), 1.0)
        return np.clip(np.where(linear, self.nominal + step, scaled), self.low, self.high)

    def z(self, theta: np.ndarray) -> np.ndarray:
        """Inverse of ``theta``: (..., n) -> (..., n)."""
        return (_t(np.asarray(theta, dtype=float), self.transform) - _t(self.nominal, self.transform)) / self.sd

    @property
    def z_low(self) -> np.ndarray:
        """Lower bounds (n,) in z."""
        return self.z(self.low)

    @property
    def z_high(self) -> np.ndarray:
        """Upper bounds (n,) in z."""
        return self.z(self.high)

    def slope(self, z: np.ndarray) -> np.ndarray:
        """d theta / d z at ``z``, (n,)."""
        theta = self.theta(z)
        return (
            np.select([self.transform == "log", self.transform == "logit"], [theta, theta * (1.0 - theta)], 1.0)
            * self.sd
        )

    def at_bound(self, z: np.ndarray, tolerance: float = 1e-6) -> np.ndarray:
        """Mask (n,) of parameters on a bound, within ``tolerance`` of the distance between the bounds.

        A parameter that started on its bound and has not moved (no damping, no restitution) does not count.
        """
        near = tolerance * _BOUNDS_WIDTH_IN_SD
        return ((z <= self.z_low + near) | (z >= self.z_high - near)) & (np.abs(z) > near)

    def columns(self, wanted: Iterable[str]) -> np.ndarray:
        """Mask (n,) of the parameters in ``wanted``, by name or by group. Raises UserError for an unknown name."""
        chosen = np.zeros(len(self), dtype=bool)
        for name in wanted:
            hit = np.array([name in (n, g) for n, g in zip(self.names, self.groups, strict=True)])
            if not hit.any():
                near = did_you_mean(name, {*self.names, *self.groups}, listed={*self.groups})
                raise UserError(f"no parameter or group {name!r} in this scene; {near}")
            chosen |= hit
        return chosen


def _precision(groups: Sequence[str], nominal: np.ndarray) -> np.ndarray:
    """Inverse covariance (n, n) of the prior in z: what the file takes for alike is correlated."""
    covariance = np.eye(len(groups))
    members: dict[tuple[str, float], list[int]] = {}
    for k, (group, value) in enumerate(zip(groups, nominal.tolist(), strict=True)):
        if group in _ALIKE:
            members.setdefault((group, value), []).append(k)
    for same in members.values():
        covariance[np.ix_(same, same)] += _CORRELATION * (1.0 - np.eye(len(same)))
    return np.linalg.inv(covariance)


def _t(theta: np.ndarray, transform: np.ndarray) -> np.ndarray:
    log, logit = transform == "log", transform == "logit"
    return np.where(transform == "linear", theta, np.log(np.where(log | logit, theta, 1.0))) - np.log1p(
        -np.where(logit, theta, 0.0)
    )
