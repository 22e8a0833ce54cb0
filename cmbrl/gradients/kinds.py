"""A model's derivative by name. Only BCG changes the simulation as well."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from cmbrl.contact.smoothing import Adaptive, Barrier
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


def _barrier(model: ComplementarityModel, seed: int, kappa: float | None, length: float | None) -> ComplementarityModel:
    return model.with_settings(backward_smoothing=Barrier(kappa, length))


def _adaptive(model: ComplementarityModel, seed: int, length: float, floor: float) -> ComplementarityModel:
    return model.with_settings(backward_smoothing=Adaptive(length, floor))


def _bundle(model: ComplementarityModel, seed: int, **noise: Any) -> RandomisedModel:
    return RandomisedModel(model, seed=seed, **noise)


def _bcg(model: ComplementarityModel, seed: int, **config: Any) -> BundledContactModel:
    return BundledContactModel(model, BundleConfig(**config), seed)


KINDS: dict[str, Kind] = {
    "exact": Kind("derivative of the step as simulated (plain FOPG on hard contact)", {}, _exact),
    "barrier": Kind("constant kappa [J] or length [m] (BS)", {"kappa": None, "length": None}, _barrier),
    "adaptive": Kind("kappa by distance, length [m] (ABS)", {"length": 1e-3, "floor": 1e-8}, _adaptive),
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
    """``adaptive:length=1e-3,floor=1e-8`` as ("adaptive", {...}); raises UserError where a value is not a number."""
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
