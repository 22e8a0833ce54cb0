"""How much each complementarity product is softened: the central-path parameter kappa [J] of every row.

kappa is an impulse [N s] times a velocity [m/s]; 0 is hard contact. A smoothing policy is data; the native core turns
it into one kappa per contact and limit (``native/smoothing.hpp``).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import one_of, real
from cmbrl.scene import Scene
from cmbrl.text import parse_fields, parse_kind

CONSTANT, GAUSSIAN = 0, 1


@dataclass(frozen=True)
class Exact:
    """Hard contact to solver accuracy: kappa = ``relative`` * m g h * 1 m/s, m the mass of the whole scene."""

    relative: float = 1e-9

    def resolve(self, scene: Scene, time_step: float) -> dict[str, Any]:
        """The core's numbers: mode, kappa [J], length [m], stop."""
        _positive(self.relative, "Exact(relative)")
        return _native(CONSTANT, self.relative * scene.total_mass * 9.81 * time_step, 0.0, False)


@dataclass(frozen=True)
class Barrier:
    """Constant softening (BS of Zhang, Jin & Wang, ICML 2023): every product equals ``kappa`` [J].

    Alternatively, ``length`` [m] sets kappa = length^2 / (2 F h^2), with F [1/kg] the mean inverse weight of the
    scene's contacts; the equivalent random perturbation of the closing speed then has scale length / h.
    """

    kappa: float | None = None
    length: float | None = None

    def resolve(self, scene: Scene, time_step: float) -> dict[str, Any]:
        """The core's numbers; raises UserError unless exactly one of kappa, length is given and positive."""
        if (self.kappa is None) == (self.length is None):
            raise UserError("Barrier needs exactly one of kappa=[J] and length=[m]")
        if self.kappa is not None:
            return _native(CONSTANT, _positive(self.kappa, "Barrier(kappa)"), 0.0, False)
        weights = scene.core.con_invweight
        weight = float(np.mean(weights)) if len(weights) else 1.0 / scene.total_mass
        length = _positive(self.length, "Barrier(length)")
        return _native(CONSTANT, length**2 / (2 * weight * time_step**2), 0.0, False)


@dataclass(frozen=True)
class Adaptive:
    """Softening by distance (ABS): kappa_i(z_i) smooths a single contact's impulse by a Gaussian of ``length`` [m].

    kappa(z) = F rho(z) rho(-z), rho the Gaussian smoothing of max(-z, 0)/F (proposition 5.3 of the ABS paper in closed
    form); z = J v_free + gap term is evaluated at the start of the step. The paper has one kappa for all contacts; one
    per contact and limit is our choice. ``floor`` [J] bounds kappa below; ``derivative="stop"`` treats kappa as a
    constant in the gradient.
    """

    length: float
    floor: float = 1e-8
    derivative: str = "exact"

    def resolve(self, scene: Scene, time_step: float) -> dict[str, Any]:
        """The core's numbers; raises UserError for a length or floor that is not positive."""
        one_of(self.derivative, ("exact", "stop"), "derivative of Adaptive")
        floor, length = _positive(self.floor, "Adaptive(floor)"), _positive(self.length, "Adaptive(length)")
        return _native(GAUSSIAN, floor, length, self.derivative == "stop")


Smoothing = Exact | Barrier | Adaptive
_KINDS: dict[str, type[Smoothing]] = {"exact": Exact, "barrier": Barrier, "adaptive": Adaptive}
_LARGEST = 1e12  # far beyond any energy [J] or length [m] of a robot; squares of it are still finite


def parse_smoothing(text: str) -> Smoothing:
    """``exact``, ``barrier:kappa=1e-4``, ``barrier:length=1e-3`` or ``adaptive:length=1e-3`` as a policy.

    Raises UserError on an unknown kind or option and on a value of the wrong type.
    """
    kind, options = parse_kind(text)
    if kind not in _KINDS:
        raise UserError(f"unknown smoothing {kind!r}: {did_you_mean(kind, _KINDS)} Example: barrier:kappa=1e-4")
    if kind == "adaptive" and "length" not in options:
        raise UserError(f"smoothing {text!r}: needs a length [m], as in adaptive:length=1e-3")
    return _KINDS[kind](**parse_fields(_KINDS[kind], options, f"smoothing {kind!r}"))


def to_config(smoothing: Smoothing) -> dict[str, Any]:
    """Description of a policy in JSON types."""
    return {"kind": type(smoothing).__name__.lower(), **asdict(smoothing)}


def from_config(config: dict[str, Any]) -> Smoothing:
    """Inverse of :func:`to_config`; raises UserError for an unknown kind."""
    fields = dict(config)
    kind = fields.pop("kind", None)
    if kind not in _KINDS:
        raise UserError(f"unknown smoothing {kind!r}; use one of {', '.join(_KINDS)}")
    return _KINDS[kind](**fields)


def _native(mode: int, kappa: float, length: float, stop: bool) -> dict[str, Any]:
    return {"mode": mode, "kappa": float(kappa), "length": float(length), "stop": int(stop)}


def _positive(value: float | None, name: str) -> float:
    return real(value, name, above=0.0, most=_LARGEST)
