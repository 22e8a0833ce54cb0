"""The models that ``cmbrl error`` compares: from the words on the command line to objects that step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from cmbrl.cli.progress import fraction
from cmbrl.cli.sources import Source, load_log, load_source
from cmbrl.errors import UserError
from cmbrl.files import read_json
from cmbrl.registry import load_task, names
from cmbrl.runs import CONFIGURATION

if TYPE_CHECKING:
    from cmbrl.data import Transitions
    from cmbrl.models.ensemble import NeuralEnsemble
    from cmbrl.models.protocol import Model
    from cmbrl.registry import Task

BUILT_IN = ("hold", "ballistic", "nominal", "ensemble")


@dataclass(frozen=True)
class Lesson:
    """What an ensemble learns from: a log's path (None: no ensemble asked for), the seed, and a limit in seconds."""

    path: str | None
    seed: int
    seconds: float | None


def check_words(words: Sequence[str], lesson: Lesson) -> None:
    """Raises UserError on a word that is neither a model of ours nor a folder that holds one, and on an ensemble
    without a log to learn from."""
    if "ensemble" in words and lesson.path is None:
        raise UserError("ensemble: has nothing to learn from: give --train FILE, a log other than --data")
    from cmbrl.models.named import check_name

    for word in words:
        if not _is_file(word):
            check_name(word, BUILT_IN)


def common_source(words: Sequence[str], scene: str | None, ignore: Sequence[str], contact_law: str | None) -> Source:
    """The scene to compare in: the one named, else that of the first fit among ``words``.

    Raises UserError when neither is given.
    """
    if scene is not None:
        return load_source(scene, ignore, contact_law)
    from cmbrl.models.named import SETTINGS, holds_fit, load_complementarity

    for word in words:
        if holds_fit(word):
            fitted = load_complementarity(Path(word) / SETTINGS)
            return Source(word, fitted.scene, task=_task_of(Path(word)), fitted=fitted)
    raise UserError("which scene? Give --scene SCENE|TASK, or name the folder of a fit among the models")


def _task_of(folder: Path) -> Task | None:
    """The task that a fit was of, if its run folder says so."""
    configuration = folder / CONFIGURATION
    word = read_json(configuration).get("source") if configuration.exists() else None
    return load_task(word) if word in names() else None


def build_models(
    words: Sequence[str], source: Source, data: Transitions, lesson: Lesson, threads: int
) -> tuple[dict[str, Model], list[str]]:
    """Name -> model, in the order of ``words``, and a line on how each that was trained here was trained.

    Raises UserError when a fit belongs to another scene or time step, or when the ensemble has nothing to learn from.
    """
    from cmbrl.models.baselines import Ballistic, HoldVelocity

    train = load_log(lesson.path, source.scene) if "ensemble" in words and lesson.path else None
    models: dict[str, Model] = {}
    notes: list[str] = []
    for word in words:
        if word == "hold":
            models[word] = HoldVelocity(source.scene, data.dt)
        elif word == "ballistic":
            models[word] = Ballistic(source.scene, data.dt)
        elif word == "nominal":
            models[word] = source.model(data, threads=threads)
        elif train is not None and word == "ensemble":
            models[word], note = _trained(source, train, lesson)
            notes.append(note)
        elif _is_file(word):
            models[_label(word, words)] = _of_file(word, source, data, threads)
        else:
            models[_label(word, words)] = _loaded(word, data, threads)
    return models, notes


def _is_file(word: str) -> bool:
    return Path(word).suffix.lower() in (".xml", ".mjcf")


def _label(path: str, words: Sequence[str]) -> str:
    """The last name of a folder, or a file's without suffix, where no other word has the same; else the path as typed."""
    name = _last_name(path)
    alone = sum(_last_name(word) == name for word in words) == 1 and name not in BUILT_IN
    return name if alone else path


def _last_name(word: str) -> str:
    return Path(word).stem if _is_file(word) else Path(word).name


def _of_file(path: str, source: Source, data: Transitions, threads: int) -> Model:
    """The model of another MJCF of the same robot, unfitted and stepped as ``source`` is."""
    scene = load_source(path, source.scene.ignore, source.scene.contact_law).scene
    have, need = ((s.nq, s.nv, s.nu) for s in (scene, source.scene))
    if have != need:
        raise UserError(f"{path}: describes another robot: nq, nv, nu are {have}, the log has {need}")
    return replace(source, word=path, scene=scene, fitted=None).model(data, threads=threads)


def _trained(source: Source, data: Transitions, lesson: Lesson) -> tuple[NeuralEnsemble, str]:
    import torch

    from cmbrl.models.ensemble import NeuralEnsemble

    ensemble = NeuralEnsemble(source.scene, data.dt)
    # One thread: the products are small, threads that wait for each other on a busy machine cost 40 times the time,
    # and the same seed gives the same weights on any machine of one kind.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with fraction(f"train ensemble on {len(data)} transitions") as progress:
        report = ensemble.fit(data, seed=lesson.seed, progress=progress, max_seconds=lesson.seconds)
    torch.set_num_threads(threads)
    log = Path(lesson.path or "").name
    note = (
        f"ensemble: trained on {len(data)} transitions of {log}, seed {lesson.seed}, {report.epochs} epochs in "
        f"{report.seconds:.0f} s (stopped by {report.stopped}), held-out error {report.holdout_error:.4f}"
    )
    return ensemble, note


def _loaded(folder: str, data: Transitions, threads: int) -> Model:
    from cmbrl.models.named import saved_model

    model = saved_model(folder, threads=threads)
    if abs(model.dt - data.dt) > 1e-6 * data.dt:
        raise UserError(f"{folder}: steps {model.dt:g} s, the log has dt {data.dt:g} s: compare on a log of that step")
    return model
