"""Models by name: "nominal" (a task's scene at the file's values), or a folder with a fit or an ensemble.

torch and mujoco are imported only to load a model, so that names are checked at once.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.errors import UserError, did_you_mean
from cmbrl.files import read_record
from cmbrl.models.neural.config import ENSEMBLE

if TYPE_CHECKING:
    import numpy as np

    from cmbrl.contact.smoothing import Smoothing
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.models.neural.ensemble import NeuralEnsemble
    from cmbrl.models.residual import ResidualModel
    from cmbrl.registry import Task
    from cmbrl.scene import Scene

NOMINAL = "nominal"
SETTINGS = "model.json"  #: the scene and the model's settings, in the folder of a fit
RESIDUAL = "residual.json"  #: of a residual and its fit, in the folder of both
RESULT = "fit.json"  #: parameters with intervals and the report; a fit is whole once it is there
_REMEDY = "fit again"


def holds_fit(folder: str | os.PathLike[str]) -> bool:
    """Whether ``folder`` holds a fit, perhaps one that was cut short (``load_complementarity`` tells)."""
    return (Path(folder) / SETTINGS).exists()


def holds_residual(folder: str | os.PathLike[str]) -> bool:
    """Whether ``folder`` holds a residual behind its fit."""
    return (Path(folder) / RESIDUAL).exists()


def check_name(word: str | os.PathLike[str], known: tuple[str, ...] = (NOMINAL,)) -> None:
    """Raises UserError unless ``word`` is one of ``known``, or a folder with a fit or an ensemble."""
    if word in known:
        return
    if not os.path.isdir(word):
        raise UserError(f"{str(word)!r} is neither a model nor a folder; {did_you_mean(str(word), known)}")
    if not holds_fit(word) and not (Path(word) / ENSEMBLE).exists():
        raise UserError(
            f"{word}: contains neither a fit ({SETTINGS}) nor an ensemble ({ENSEMBLE}); give the folder of one"
        )


def named_model(
    word: str | os.PathLike[str],
    task: Task,
    smoothing: Smoothing | None = None,
    threads: int | None = None,
    candidates: np.ndarray | None = None,
) -> ComplementarityModel | ResidualModel | NeuralEnsemble:
    """``task``'s nominal model, or the model in the folder ``word`` (see ``saved_model``).

    ``candidates`` (K, np) are parameter sets of a fit, in the order of its own scene. A fit is taken at another control
    step, and for another file of the robot (:mod:`cmbrl.models.carried`).

    Raises UserError if the folder has no model, or one of another robot, or an ensemble or residual of another control
    step.
    """
    from cmbrl.models.carried import fit_for
    from cmbrl.models.complementarity import ComplementarityModel

    nominal = nominal_model(task, **_given(smoothing, threads))
    if word == NOMINAL:
        return nominal
    model = saved_model(word, smoothing, threads, candidates)
    if isinstance(model, ComplementarityModel):
        return fit_for(model, nominal, str(word))
    own, scene = model.coordinates, nominal.scene
    have, need = (own.nq, own.nv, own.nu), (scene.nq, scene.nv, scene.nu)
    if have != need:
        raise UserError(f"{word}: model of another robot: nq, nv, nu {have}, task {task.name!r} has {need}")
    if abs(model.dt - task.control_dt) > 1e-6 * task.control_dt:
        raise UserError(
            f"{word}: steps {model.dt:g} s, task {task.name!r} {task.control_dt:g} s; fit it to a log of that step "
            f"(`cmbrl import --rate {1 / task.control_dt:g}`)"
        )
    return model


def saved_model(
    folder: str | os.PathLike[str],
    smoothing: Smoothing | None = None,
    threads: int | None = None,
    candidates: np.ndarray | None = None,
) -> ComplementarityModel | ResidualModel | NeuralEnsemble:
    """The model in ``folder``; ``smoothing``, ``threads`` and ``candidates`` replace those of a fit.

    Raises UserError if there is none, or if ``smoothing`` is given for an ensemble.
    """
    check_name(folder)
    if holds_fit(folder):
        model = load_complementarity(folder).with_settings(**_given(smoothing, threads), candidates=candidates)
        return _with_residual(folder, model)
    if smoothing is not None:
        raise UserError(f"{folder}: smoothing does not apply to an ensemble; drop it")
    from cmbrl.models.neural.ensemble import NeuralEnsemble

    return NeuralEnsemble.load(folder)


def _with_residual(folder: str | os.PathLike[str], model: ComplementarityModel) -> ComplementarityModel | ResidualModel:
    if not holds_residual(folder):
        return model
    from cmbrl.models.residual import ResidualModel

    return ResidualModel.load(folder, model)


def _given(smoothing: Smoothing | None, threads: int | None) -> dict[str, Any]:
    chosen = {"smoothing": smoothing, "threads": threads}
    return {name: value for name, value in chosen.items() if value is not None}


def nominal_model(task: Task, scene: Scene | None = None, **options: Any) -> ComplementarityModel:
    """The model of the task's scene at its nominal parameters; ``options`` override the task's settings.

    ``scene``: the task's scene if already loaded, perhaps with other import options. Another ``time_step`` alone takes
    as many substeps as make the task's control step; raises UserError where no whole number does.
    """
    from cmbrl.contact.smoothing import Relaxed
    from cmbrl.models.complementarity import ComplementarityModel

    settings = task.model_options() | {"smoothing": Relaxed(task.smoothing_speed)}
    stepped = "time_step" in options and "substeps" not in options
    settings |= {"substeps": 1} if stepped else {}
    model = ComplementarityModel(scene or task.load_scene(), **(settings | options))
    return model.for_log(task.control_dt) if stepped else model


def task_of_fit(folder: str | os.PathLike[str]) -> str | None:
    """The name of the task whose scene was fitted, if there was one; raises UserError if the file is damaged."""
    found: str | None = read_record(Path(folder) / SETTINGS, _REMEDY).get("task")
    return found


def in_own_file(fit: ComplementarityModel, folder: str | os.PathLike[str]) -> ComplementarityModel:
    """``fit``, that of ``folder``, without play that was added to its robot's file (``FitResult.save``)."""
    from cmbrl.models.carried import without_play
    from cmbrl.scene import Scene

    file = read_record(Path(folder) / SETTINGS, _REMEDY).get("without_play")
    if file is None:
        return fit
    s = fit.scene
    scene = Scene.from_mjcf(file, s.ignore, s.contact_law, s.reduce, s.self_contact, s.drives)
    return without_play(fit, scene)


def load_complementarity(folder: str | os.PathLike[str]) -> ComplementarityModel:
    """The model of the fit in ``folder``.

    Raises UserError if a file is missing or damaged, if its files are not of one fit, or if the scene is missing or has
    changed.
    """
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.scene import Scene
    from cmbrl.scene.drives import Drive

    file, result = Path(folder) / SETTINGS, Path(folder) / RESULT
    if not result.is_file():
        raise UserError(f"{folder}: the fit there is not finished ({RESULT} is missing): {_REMEDY}, or --resume it")
    config, fitted = read_record(file, _REMEDY), read_record(result, _REMEDY)
    try:
        values = {name: parameter["value"] for name, parameter in fitted["parameters"].items()}
        if values != config["settings"]["parameters"] | config["settings"]["observation"]:
            raise UserError(f"{folder}: {SETTINGS} and {RESULT} are not of the same fit: {_REMEDY}")
        source, settings = config["scene"], config["settings"]
        scene = Scene.from_mjcf(
            source["path"],
            ignore=source["ignore"],
            contact_law=source["contact_law"],
            self_contact=source.get("self_contact", "near"),
            reduce=source.get("reduce", True),
            drives=[Drive(**drive) for drive in source.get("drives", ())],
        )
        return ComplementarityModel.from_config(scene, settings)
    except UserError as error:
        raise UserError(f"{file}: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        raise UserError(f"{file}: damaged; {_REMEDY}") from None
