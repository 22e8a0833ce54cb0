"""A model's derivative by name. Only BCG changes the simulation as well."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from cmbrl.contact.smoothing import ABS, HARD_SPEED, Barrier, Gaussian, Relaxed, Smoothing
from cmbrl.errors import UserError, did_you_mean
from cmbrl.gradients.bcg import BundleConfig, BundledContactModel
from cmbrl.gradients.randomised import RandomisedModel
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.numbers import one_of, real, whole
from cmbrl.text import LARGEST, parse_kind, parse_number, shortened

_BRANCHES = 100_000  # each is a step of its own
_LARGEST = 1e12  # of a length, a noise or an energy
DerivativeModel = ComplementarityModel | RandomisedModel | BundledContactModel


@dataclass(frozen=True)
class Kind:
    """``options`` and their defaults; for None, what is made has its own."""

    summary: str
    options: dict[str, Any]
    make: Callable[..., DerivativeModel]


def _exact(model: ComplementarityModel, seed: int) -> ComplementarityModel:
    return model.with_settings(backward_smoothing=model.smoothing)


def _soft(policy: Callable[..., Smoothing]) -> Callable[..., ComplementarityModel]:
    def make(model: ComplementarityModel, seed: int, **options: Any) -> ComplementarityModel:
        return model.with_settings(backward_smoothing=policy(**options))

    return make


def _bundle(model: ComplementarityModel, seed: int, **noise: Any) -> RandomisedModel:
    return RandomisedModel(model, seed=seed, **noise)


def _bcg(model: ComplementarityModel, seed: int, **config: Any) -> BundledContactModel:
    return BundledContactModel(model, BundleConfig(**config), seed)


_GAUSSIAN = {"length": 1e-3, "floor": HARD_SPEED}
KINDS: dict[str, Kind] = {
    "exact": Kind("derivative of the step as simulated (plain FOPG on hard contact)", {}, _exact),
    "relaxed": Kind("constant kappa, scaled by row; speed [m/s]", {"speed": 3e-4}, _soft(Relaxed)),
    "barrier": Kind("constant kappa [J] or length [m] (BS)", {"kappa": None, "length": None}, _soft(Barrier)),
    "gaussian": Kind("kappa of each row by its distance; length [m]", _GAUSSIAN, _soft(Gaussian)),
    "gaussian-stopped": Kind(
        "the same, kappa a constant to the derivative", _GAUSSIAN, _soft(partial(Gaussian, derivative="stop"))
    ),
    "abs": Kind(
        "one kappa [J] by the gap of the nearest idle contact (ABS)",
        {"peak": 0.1, "reach": 1e-3, "floor": HARD_SPEED},
        _soft(ABS),
    ),
    "bundle": Kind(
        "mean Jacobian over noise in every step",
        {"samples": 16, "position": 1e-3, "velocity": 0.0, "control": 0.0},
        _bundle,
    ),
    "bcg": Kind("Bundled Contact Gradients: branches near contact", asdict(BundleConfig()), _bcg),
}


def derivative_model(
    model: ComplementarityModel, kind: str = "exact", seed: int = 0, **options: Any
) -> DerivativeModel:
    """``model`` with a derivative of the given kind; ``seed`` draws its noise, if any.

    Raises UserError for an unknown kind or option, or a value out of range.
    """
    known = KINDS[one_of(kind, KINDS, "derivative")].options
    seed = whole(seed, "seed", least=0)
    for name in options:
        if name not in known:
            remedy = did_you_mean(name, known) if known else "it has none"
            raise UserError(f"derivative {kind!r} has no option {name!r}: {remedy}")
        if options[name] is None and known[name] is None:
            continue
        if isinstance(known[name], int) or (name == "length" and kind == "bcg"):
            whole(options[name], f"derivative {kind!r}, {name}", most=_BRANCHES)
        else:
            real(options[name], f"derivative {kind!r}, {name}", least=0.0, most=_LARGEST)
    return KINDS[kind].make(model, seed, **(known | options))


def parse_derivative(text: str) -> tuple[str, dict[str, Any]]:
    """``gaussian:length=1e-3,floor=1e-9`` as ("gaussian", {...}); raises UserError where a value is not a number."""
    kind, texts = parse_kind(text)
    options: dict[str, Any] = {}
    for name, value in texts.items():
        try:
            number = float(parse_number(value))
            if math.isinf(number):
                raise ValueError("must be finite")
        except ValueError as error:
            raise UserError(f"derivative {kind!r}, {name}={shortened(value)}: {error}") from None
        options[name] = int(number) if number.is_integer() and 1 <= number <= LARGEST else number
    return kind, options


def steps_taken(model: object, simulated: int) -> int:
    """Model steps: as a bundle counts them, else as many as were simulated."""
    return model.steps if isinstance(model, RandomisedModel | BundledContactModel) else simulated
