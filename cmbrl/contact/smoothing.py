"""How much each complementarity product is softened: the central-path parameter kappa [J] of every row.

kappa is an impulse [N s] times a velocity [m/s]; 0 is hard contact. A smoothing policy is data; the native core turns
it into one kappa per contact and limit (``native/smoothing.hpp``). No policy softens dry friction in joints by what it
does to contacts: a joint at half its friction loss creeps at 2/3 of ``dry``, a speed [rad/s or m/s].
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import one_of, real
from cmbrl.scene import Scene
from cmbrl.text import parse_fields, parse_kind

HARD_SPEED = 1e-9  # [m/s]: softening that only the solver needs
DRY_SPEED = 3e-4  # [rad/s or m/s]: softening of dry friction where that of contacts is given in joules
HARD_DRY_SPEED = 1e-6  # the same for hard contact: unseen, and cheaper to solve for than less
_LOWEST_GRAVITY = 1.0  # [m/s^2]: where there is less, rows are softened as if there were as much
_LARGEST = 1e12  # far beyond any energy [J] or length [m] of a robot; squares of it are still finite


class Mode(IntEnum):
    """The core's words for policies."""

    CONSTANT = 0
    GAUSSIAN = 1
    SCALED = 2
    NEAREST = 3


@dataclass(frozen=True)
class Exact:
    """Hard contact to solver accuracy: every row has its own kappa = ``speed`` * g * h / w.

    w [1/kg] is the row's inverse weight and g the scene's gravity, so that a body's contacts do not depend on what
    else is in the scene. A resting body hovers at ``speed`` * h. For a hinge limit one radian counts as one metre.
    """

    speed: float = HARD_SPEED

    def resolve(self, scene: Scene, time_step: float) -> dict[str, Any]:
        """The core's numbers; raises UserError for a speed that is not positive."""
        return _scaled(_positive(self.speed, "Exact(speed)"), scene, time_step)


@dataclass(frozen=True)
class Relaxed:
    """The softening of :class:`Exact`, large enough to make solves short and derivatives see a contact that is near."""

    speed: float = 3e-4

    def resolve(self, scene: Scene, time_step: float) -> dict[str, Any]:
        """The core's numbers; raises UserError for a speed that is not positive."""
        return _scaled(_positive(self.speed, "Relaxed(speed)"), scene, time_step)


@dataclass(frozen=True)
class Barrier:
    """Constant softening (BS of Zhang, Jin & Wang, ICML 2023): every product of a contact or limit is ``kappa`` [J].

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
            return _native(Mode.CONSTANT, scene, time_step, kappa=_positive(self.kappa, "Barrier(kappa)"))
        weights = scene.core.con_invweight
        weight = float(np.mean(weights)) if len(weights) else 1.0 / scene.total_mass
        length = _positive(self.length, "Barrier(length)")
        return _native(Mode.CONSTANT, scene, time_step, kappa=length**2 / (2 * weight * time_step**2))


@dataclass(frozen=True)
class Gaussian:
    """Softening of each row by its own distance: kappa(z) smooths a single contact's impulse by a Gaussian.

    kappa(z) = F rho(z) rho(-z), rho the Gaussian smoothing of max(-z, 0)/F with standard deviation ``length`` / h
    (proposition 5.3 of the ABS paper in closed form); z = J v_free + gap term is evaluated at the start of the step,
    F is the row's inverse weight and compliance. One kappa per row, loaded contacts included, is our own schedule, not
    the paper's rule (:class:`ABS`). ``floor`` [m/s] bounds kappa below as the speed of :class:`Exact` does.
    ``derivative="stop"`` treats kappa as a constant in the gradient.
    """

    length: float
    floor: float = HARD_SPEED
    derivative: str = "exact"

    def resolve(self, scene: Scene, time_step: float) -> dict[str, Any]:
        """The core's numbers; raises UserError for a length or floor that is not positive."""
        one_of(self.derivative, ("exact", "stop"), "derivative of Gaussian")
        floor, length = _positive(self.floor, "Gaussian(floor)"), _positive(self.length, "Gaussian(length)")
        stop = self.derivative == "stop"
        return _native(Mode.GAUSSIAN, scene, time_step, length=length, speed=floor, stop=stop)


@dataclass(frozen=True)
class ABS:
    """Adaptive barrier smoothing by the published rule: one kappa for the step, set by the nearest inactive contact.

    kappa = g(d), d [m] the smallest absolute gap among contacts that carry no load, held fixed in the derivative
    (Zhang, Jin & Wang, ICML 2023, Algorithm 1). Which contacts carry load is read off the hard solution of the step.
    The paper does not print the function g of its experiments; ours is g(d) = ``peak`` exp(-(d / ``reach``)^2) [J].
    No row gets less than the kappa of :class:`Exact` with speed ``floor`` [m/s].
    """

    peak: float
    reach: float
    floor: float = HARD_SPEED

    def resolve(self, scene: Scene, time_step: float) -> dict[str, Any]:
        """The core's numbers; raises UserError for a value that is not positive."""
        peak, reach, floor = (_positive(getattr(self, f.name), f"ABS({f.name})") for f in fields(self))
        return _native(Mode.NEAREST, scene, time_step, kappa=peak, length=reach, speed=floor, stop=True)


Smoothing = Exact | Relaxed | Barrier | Gaussian | ABS
KINDS: dict[str, type[Smoothing]] = {
    "exact": Exact,
    "relaxed": Relaxed,
    "barrier": Barrier,
    "gaussian": Gaussian,
    "abs": ABS,
}
_NEEDED = {"gaussian": "length=1e-3", "abs": "peak=0.1,reach=1e-3"}


def parse_smoothing(text: str) -> Smoothing:
    """``exact``, ``relaxed:speed=3e-4``, ``barrier:kappa=1e-4`` or ``gaussian:length=1e-3`` as a policy.

    Raises UserError on an unknown kind or option and on a value of the wrong type.
    """
    kind, options = parse_kind(text)
    if kind not in KINDS:
        raise UserError(f"unknown smoothing {kind!r}: {did_you_mean(kind, KINDS)} Example: barrier:kappa=1e-4")
    example = _NEEDED.get(kind, "")
    missing = [part.split("=")[0] for part in example.split(",") if part and part.split("=")[0] not in options]
    if missing:
        raise UserError(f"smoothing {text!r}: needs {' and '.join(missing)}, as in {kind}:{example}")
    return KINDS[kind](**parse_fields(KINDS[kind], options, f"smoothing {kind!r}"))


def to_config(smoothing: Smoothing) -> dict[str, Any]:
    """Description of a policy in JSON types."""
    return {"kind": type(smoothing).__name__.lower(), **asdict(smoothing)}


def from_config(config: dict[str, Any]) -> Smoothing:
    """Inverse of :func:`to_config`; raises UserError for an unknown kind or option."""
    options = dict(config)
    kind = options.pop("kind", None)
    if kind not in KINDS:
        raise UserError(f"unknown smoothing {kind!r}; use one of {', '.join(KINDS)}")
    known = {f.name for f in fields(KINDS[kind])}
    for name in options:
        if name not in known:
            raise UserError(f"smoothing {kind!r} has no option {name!r}; use {', '.join(sorted(known))}")
    return KINDS[kind](**options)


def _scaled(speed: float, scene: Scene, time_step: float) -> dict[str, Any]:
    return _native(Mode.SCALED, scene, time_step, speed=speed, dry=max(speed, HARD_DRY_SPEED))


def _native(
    mode: Mode, scene: Scene, time_step: float, kappa: float = 0.0, length: float = 0.0,
    speed: float = HARD_SPEED, dry: float = DRY_SPEED, stop: bool = False,
) -> dict[str, Any]:  # fmt: skip
    gravity = max(float(np.linalg.norm(scene.gravity)), _LOWEST_GRAVITY)
    floor = speed * gravity * time_step
    return {"mode": int(mode), "kappa": kappa, "floor": floor, "dry": dry, "length": length, "stop": int(stop)}


def _positive(value: float | None, name: str) -> float:
    return real(value, name, above=0.0, most=_LARGEST)
