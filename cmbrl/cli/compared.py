"""The models that ``cmbrl error`` compares: from the words on the command line to objects that step."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cmbrl.cli.progress import fraction
from cmbrl.cli.sources import Source, load_log, load_source
from cmbrl.errors import UserError, did_you_mean

if TYPE_CHECKING:
    from cmbrl.data import Transitions
    from cmbrl.models.ensemble import NeuralEnsemble
    from cmbrl.models.protocol import Model

BUILT_IN = ("hold", "ballistic", "nominal", "ensemble")
FIT_FILE, ENSEMBLE_FILE = "fit.json", "ensemble.json"


def check_words(words: Sequence[str]) -> None:
    """Raises UserError on a word that is neither a model of ours nor a folder that holds one."""
    for word in words:
        if word in BUILT_IN:
            continue
        if not Path(word).is_dir():
            raise UserError(f"no model {word!r}: {did_you_mean(word, BUILT_IN)} Or name the folder of a fit")
        if not any((Path(word) / name).exists() for name in (FIT_FILE, ENSEMBLE_FILE)):
            raise UserError(f"{word}: holds neither a fit ({FIT_FILE}) nor an ensemble ({ENSEMBLE_FILE})")


def common_source(words: Sequence[str], scene: str | None, ignore: Sequence[str], contact_law: str | None) -> Source:
    """The scene to compare in: the one named, else that of the first fit among ``words``.

    Raises UserError when neither is given.
    """
    if scene is not None:
        return load_source(scene, ignore, contact_law)
    for word in words:
        if (Path(word) / FIT_FILE).exists():
            from cmbrl.fit import FitResult

            fitted = FitResult.load(word).model
            return Source(fitted.scene.path, fitted.scene, fitted=fitted)
    raise UserError("which scene? Give --scene SCENE|TASK, or name the folder of a fit among the models")


def build_models(
    words: Sequence[str], source: Source, data: Transitions, train: str | None, seed: int, threads: int
) -> dict[str, Model]:
    """Name -> model, in the order of ``words``; an ensemble is trained on the log ``train``.

    Raises UserError when a fit belongs to another scene or time step, or when the ensemble has nothing to learn from.
    """
    from cmbrl.models.baselines import Ballistic, HoldVelocity
    from cmbrl.models.ensemble import NeuralEnsemble

    lesson = None
    if "ensemble" in words:
        if train is None:
            raise UserError("ensemble: has nothing to learn from: give --train FILE, a log other than --data")
        lesson = load_log(train, source.scene)
    models: dict[str, Model] = {}
    for word in words:
        if word == "hold":
            models[word] = HoldVelocity(source.scene, data.dt)
        elif word == "ballistic":
            models[word] = Ballistic(source.scene, data.dt)
        elif word == "nominal":
            models[word] = source.model(data, threads=threads)
        elif word == "ensemble":
            assert lesson is not None
            models[word] = _trained(NeuralEnsemble(source.scene, data.dt), lesson, seed)
        else:
            models[word] = _loaded(word, data, threads)
    return models


def _trained(ensemble: NeuralEnsemble, lesson: Transitions, seed: int) -> NeuralEnsemble:
    with fraction(f"train ensemble on {len(lesson)} transitions") as progress:
        ensemble.fit(lesson, seed=seed, progress=progress)
    return ensemble


def _loaded(folder: str, data: Transitions, threads: int) -> Model:
    from cmbrl.fit import FitResult
    from cmbrl.models.ensemble import NeuralEnsemble

    if (Path(folder) / FIT_FILE).exists():
        model: Model = FitResult.load(folder).model.with_settings(threads=threads)
    else:
        model = NeuralEnsemble.load(folder)
    if abs(model.dt - data.dt) > 1e-6 * data.dt:
        raise UserError(f"{folder}: steps {model.dt:g} s, the log has dt {data.dt:g} s: compare on a log of that step")
    return model
