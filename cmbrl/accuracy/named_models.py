"""The models that `cmbrl error` compares, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
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
    from cmbrl.models.ensemble import NeuralEnsemble
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

    Raises UserError on a word that is neither built in nor the folder of a model, and when there is no scene.
    """
    from cmbrl.models.named import check_name, holds_fit, in_own_file, load_complementarity

    for word in words:
        if not _is_file(word):
            check_name(word, BUILT_IN)
    if scene is not None:
        return load_source(scene, ignore, contact_law, self_contact)
    for word in words:
        if holds_fit(word):
            fitted = in_own_file(load_complementarity(word), word)
            return Source(word, fitted.scene, task=_task_of(word), fitted=fitted)
    raise UserError("no scene: give --scene SCENE|TASK, or name the folder of a fit among the models")


def build_models(
    words: Sequence[str], source: Source, data: Transitions, threads: int, sliding: str | None = None
) -> dict[str, Any]:
    """Name -> model, in the order of ``words``; the "ensemble" is still to be trained.

    ``sliding``: of models that are not saved ones; None: that of the source.

    A fit takes the control steps of ``data``. Raises UserError when the model of a folder or a file is of another
    robot, and where a net was trained for another step.
    """
    from cmbrl.models.baselines import Ballistic, HoldVelocity
    from cmbrl.models.ensemble import NeuralEnsemble

    scene = source.scene
    make: dict[str, Callable[[], Model]] = {
        HOLD: lambda: HoldVelocity(source.scene, data.dt),
        BALLISTIC: lambda: Ballistic(source.scene, data.dt),
        NOMINAL: lambda: source.model(data, threads=threads, sliding=sliding),
        ENSEMBLE: lambda: NeuralEnsemble(source.scene, data.dt),
    }
    for word in words:
        if word not in make:
            load = partial(_of_file, word, source, sliding) if _is_file(word) else partial(_loaded, word, scene)
            make[word] = partial(load, data, threads)
    return {_label(word, words): make[word]() for word in words}


def notes_on_laws(models: Mapping[str, Any], words: Sequence[str]) -> list[str]:
    """A line where a file's model slides by a law that is not MuJoCo's: it may look worse than the file is."""
    from cmbrl.models.complementarity import ComplementarityModel

    names = [_label(word, words) for word in words if word == NOMINAL or _is_file(word)]
    told = [name for name in names if isinstance(one := models[name], ComplementarityModel) and _slides_apart(one)]
    if not told:
        return []
    return [f"{', '.join(told)}: slides by exact Coulomb; if MuJoCo made the log, give it that law by --sliding convex"]


def _slides_apart(model: ComplementarityModel) -> bool:
    return model.sliding == "coulomb" and model.scene.contact_law == "mujoco" and bool(len(model.scene.contact_names))


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


def _label(word: str, words: Sequence[str]) -> str:
    """The last name of a folder, or of a file without its suffix, if no other word has the same; else the word."""
    name = _last_name(word)
    unique = sum(_last_name(other) == name for other in words) == 1 and (name not in BUILT_IN or word == name)
    return name if unique else word


def _last_name(word: str) -> str:
    return Path(word).stem if _is_file(word) else Path(word).name


def _is_file(word: str) -> bool:
    return Path(word).suffix.lower() in (".xml", ".mjcf", ".urdf")


def _of_file(path: str, source: Source, sliding: str | None, data: Transitions, threads: int) -> Model:
    """The model of another MJCF of the same robot, not fitted, with the time stepping of ``source``."""
    scene = load_source(path, source.scene.ignore, source.scene.contact_law, source.scene.self_contact).scene
    have, need = ((s.nq, s.nv, s.nu) for s in (scene, source.scene))
    if have != need:
        raise UserError(f"{path}: another robot: nq, nv, nu are {have}, the log has {need}")
    return replace(source, word=path, scene=scene, fitted=None).model(data, threads=threads, sliding=sliding)


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
