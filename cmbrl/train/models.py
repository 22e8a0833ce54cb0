"""What a policy is trained or tried on, by name: "nominal", "ensemble", "real", or the folder of a fit or ensemble."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cmbrl.errors import UserError
from cmbrl.train import algorithms as kinds

if TYPE_CHECKING:
    from cmbrl.gradients.kinds import DerivativeModel
    from cmbrl.models.protocol import Model
    from cmbrl.registry import Task

NOMINAL, ENSEMBLE, REAL = "nominal", "ensemble", "real"
_BUILT_IN = {NOMINAL: kinds.CONTACT, ENSEMBLE: kinds.UNTRAINED, REAL: kinds.REAL}  # name -> kind


def check_model(word: str) -> None:
    """Raises UserError unless ``word`` is a built-in name or a folder that holds a fit or an ensemble."""
    from cmbrl.models.named import check_name

    check_name(word, tuple(_BUILT_IN))


def kind_of(word: str) -> str:
    """The kind of model, as in `cmbrl.train.algorithms`, that a checked ``word`` names."""
    from cmbrl.models.named import holds_fit, holds_residual

    fitted = kinds.RESIDUAL if holds_residual(word) else kinds.CONTACT
    return _BUILT_IN.get(word) or (fitted if holds_fit(word) else kinds.ENSEMBLE)


def usual_model(kind: str) -> str:
    """The built-in name for a ``kind`` of model."""
    return next((word for word, its in _BUILT_IN.items() if its == kind), NOMINAL)


def load_model(
    word: str, task: Task, smoothing: str | None = None, threads: int | None = None, draws: int = 0, seed: int = 0
) -> Model:
    """The next-state model that a checked ``word`` other than "real" names; an untrained one for "ensemble".

    A fit is taken as it trains policies (``ComplementarityModel.for_training``).

    Args:
        word: "nominal", "ensemble", or the folder of a fit or an ensemble.
        task: whose robot the model must be of.
        smoothing: as for ``cmbrl.contact.smoothing.parse_smoothing``; None: that of the task.
        threads: of the native core; None: the model's own.
        draws, seed: how many parameter sets of a fit's posterior become its candidates, and the seed that draws them.

    Raises UserError on a model of another robot or control step, and on smoothing of an ensemble.
    """
    from cmbrl.contact.smoothing import Relaxed, parse_smoothing
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.models.named import holds_fit, named_model, nominal_model
    from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble

    if smoothing is not None and kind_of(word) not in (kinds.CONTACT, kinds.RESIDUAL):
        raise UserError(f"--smoothing does not apply to an ensemble ({word}): drop it")
    if word == ENSEMBLE:
        return NeuralEnsemble(task.load_scene(), task.control_dt, EnsembleConfig.original())
    candidates = None
    if draws and word not in _BUILT_IN and holds_fit(word):
        from cmbrl.fitting import FitResult

        candidates = FitResult.load(word).candidates(draws, seed)
    policy = parse_smoothing(smoothing) if smoothing else None
    model = named_model(word, task, policy, threads, candidates)
    if word == NOMINAL or not isinstance(model, ComplementarityModel):
        return model
    return model.for_training(policy or Relaxed(task.smoothing_speed), nominal_model(task, model.scene))


def with_derivative(model: object, text: str, seed: int, refits: bool) -> DerivativeModel:
    """``model`` with the derivative that ``text`` describes, as for ``cmbrl.gradients.kinds.parse_derivative``.

    ``seed`` is that of the derivative's noise; ``refits``: the algorithm changes the model's parameters.
    Raises UserError for a model without contacts, and for a bundle around a model that is to be refitted.
    """
    from cmbrl.gradients.kinds import derivative_model, parse_derivative
    from cmbrl.models.complementarity import ComplementarityModel

    if not isinstance(model, ComplementarityModel):
        raise UserError("--derivative applies only to a contact model without a residual: drop it")
    kind, options = parse_derivative(text)
    found = derivative_model(model, kind, seed, **options)
    if refits and not isinstance(found, ComplementarityModel):
        raise UserError(f"--derivative {text}: this algorithm refits its model, which a {kind} prevents: use gaussian")
    return found
