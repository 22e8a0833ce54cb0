"""The models that `cmbrl error` compares, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.accuracy.view import scene_of
from cmbrl.data.checks import TIME_STEP_TOLERANCE
from cmbrl.errors import UserError
from cmbrl.models.carried import is_without_play
from cmbrl.models.source import Source, load_source
from cmbrl.registry import is_task, load_task

if TYPE_CHECKING:
    from cmbrl.data import Transitions
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.models.neural.ensemble import NeuralEnsemble
    from cmbrl.models.protocol import Model
    from cmbrl.registry import Task
    from cmbrl.scene import Scene

HOLD, BALLISTIC, NOMINAL, ENSEMBLE = "hold", "ballistic", "nominal", "ensemble"
BUILT_IN = (HOLD, BALLISTIC, NOMINAL, ENSEMBLE)


def common_source(
    words: Sequence[str],
    scene: str | None = None,
    ignore: Sequence[str] = (),
    contact_law: str | None = None,
    self_contact: str = "near",
) -> Source:
    """The scene to compare in: ``scene``, or that of the first fit among ``words``, without play that the fit added.

    Files step as the first fit does and take its laws of contact, so that one table compares parameters; not where
    ``scene`` is a task, which has its own, nor under another ``contact_law``.

    Raises UserError on a word that is neither built in nor the folder of a model, and when there is no scene.
    """
    from cmbrl.models.named import check_name

    for word in words:
        if not is_file(word):
            check_name(word, BUILT_IN)
    if scene is None:
        if (found := _first_fit(words)) is None:
            raise UserError("no scene: give --scene SCENE|TASK, or name the folder of a fit among the models")
        word, fitted = found
        return Source(word, fitted.scene, task=_task_of(word), fitted=fitted)
    source = load_source(scene, ignore, contact_law, self_contact)
    if source.task is None and (found := _first_fit(words)) and found[1].scene.contact_law == source.scene.contact_law:
        return replace(source, fitted=found[1])
    return source


def _first_fit(words: Sequence[str]) -> tuple[str, ComplementarityModel] | None:
    from cmbrl.models.named import holds_fit, in_own_file, load_complementarity

    word = next(filter(holds_fit, words), None)
    return (word, in_own_file(load_complementarity(word), word)) if word is not None else None


def build_models(
    words: Sequence[str],
    source: Source,
    data: Transitions,
    threads: int,
    sliding: str | None = None,
    driven: Callable[[Scene], Scene] | None = None,
) -> dict[str, Any]:
    """Name -> model, in the order of ``words``; the "ensemble" is still to be trained.

    ``sliding``: of models that are not saved ones; None: that of the source. ``driven``: a scene as the commands of the
    log drive it, which the scene of ``source`` already is: a motor of a file that gets targets becomes a servo. A fit
    takes the control steps of ``data``. Raises UserError when the model of a folder or a file is of another robot, and
    where a net was trained for another step.
    """
    from cmbrl.models.baselines import Ballistic, HoldVelocity
    from cmbrl.models.neural.ensemble import NeuralEnsemble

    scene = source.scene
    make: dict[str, Callable[[], Model]] = {
        HOLD: lambda: HoldVelocity(source.scene, data.dt),
        BALLISTIC: lambda: Ballistic(source.scene, data.dt),
        NOMINAL: lambda: source.model(data, threads=threads, sliding=sliding),
        ENSEMBLE: lambda: NeuralEnsemble(source.scene, data.dt),
    }
    for word in words:
        if word not in make:
            load = partial(_of_file, word, source, sliding, driven) if is_file(word) else partial(_loaded, word, scene)
            make[word] = partial(load, data, threads)
    return {label(word, words): make[word]() for word in words}


def train_ensemble(
    ensemble: NeuralEnsemble,
    data: Transitions,
    seed: int = 0,
    max_seconds: float | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> str:
    """Trains on one thread of torch, so that the result depends on the seed alone; returns one line about it.

    The matrices are small: more threads would only wait for each other.
    """
    with _one_thread():
        report = ensemble.fit(data, seed=seed, progress=progress, max_seconds=max_seconds)
    if report.stopped == "interrupted":  # an ensemble that Ctrl-C has cut short would be compared as if it were whole
        raise KeyboardInterrupt
    return (
        f"trained on {len(data)} transitions, seed {seed}, {report.epochs} epochs in {report.seconds:.0f} s "
        f"(stopped by {report.stopped}), held-out error {report.holdout_error:.4f}"
    )


@contextmanager
def _one_thread() -> Iterator[None]:
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _task_of(folder: str) -> Task | None:
    """The task of the fit in ``folder``, if it is of one."""
    from cmbrl.models.named import task_of_fit

    word = task_of_fit(folder)
    return load_task(word) if word is not None and is_task(word) else None


def label(word: str, words: Sequence[str]) -> str:
    """The last name of a folder, or of a file without its suffix, if no other word has the same; else the word."""
    name = _last_name(word)
    unique = sum(_last_name(other) == name for other in words) == 1 and (name not in BUILT_IN or word == name)
    return name if unique else word


def _last_name(word: str) -> str:
    return Path(word).stem if is_file(word) else Path(word).name


def is_file(word: str) -> bool:
    return Path(word).suffix.lower() in (".xml", ".mjcf", ".urdf")


def _of_file(
    path: str,
    source: Source,
    sliding: str | None,
    driven: Callable[[Scene], Scene] | None,
    data: Transitions,
    threads: int,
) -> Model:
    """The model of another MJCF of the same robot, not fitted, with the laws and the time stepping of ``source``."""
    scene = load_source(path, source.scene.ignore, source.scene.contact_law, source.scene.self_contact).scene
    have, need = ((s.nq, s.nv, s.nu) for s in (scene, source.scene))
    if have != need:
        raise UserError(f"{path}: another robot: nq, nv, nu are {have}, the log has {need}")
    try:
        scene = driven(scene) if driven is not None else scene
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return replace(source, word=path, scene=scene).model(data, threads=threads, sliding=sliding)


def _loaded(folder: str, scene: Scene, data: Transitions, threads: int) -> Model:
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.models.named import saved_model

    model = saved_model(folder, threads=threads)
    have, need = ((s.nq, s.nv, s.nu) for s in (model.coordinates, scene))
    if have != need and not ((own := scene_of(model)) and is_without_play(scene, own)):
        raise UserError(
            f"{folder}: model of another robot: nq, nv, nu are {have}, of scene {scene.name!r} {need}; compare it by a "
            "command of its own"
        )
    if abs(model.dt - data.dt) <= TIME_STEP_TOLERANCE * data.dt:
        return model
    if isinstance(model, ComplementarityModel):
        return model.at(data.dt)
    raise UserError(
        f"{folder}: has a step of {model.dt:g} s, the log has dt {data.dt:g} s: use a log of "
        "that step (`cmbrl import --rate` tells the rate of stamps that jitter)"
    )
