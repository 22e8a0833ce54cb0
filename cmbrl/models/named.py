"""Models by name: "nominal", a task's scene as its file has it, or a folder that holds a fit or an ensemble.

torch and mujoco are imported only for what is loaded: names are checked at once, and before a renderer is chosen.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.errors import UserError, did_you_mean
from cmbrl.files import read_json

if TYPE_CHECKING:
    from cmbrl.contact.smoothing import Smoothing
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.models.ensemble import NeuralEnsemble
    from cmbrl.registry import Task
    from cmbrl.scene import Scene

NOMINAL = "nominal"
SETTINGS = "model.json"  #: in the folder of a fit: the scene and how the model steps it
ENSEMBLE = "ensemble.json"  #: in the folder of an ensemble


def holds_fit(folder: str | os.PathLike[str]) -> bool:
    """Whether ``folder`` is that of a fit."""
    return (Path(folder) / SETTINGS).exists()


def check_name(word: str | os.PathLike[str], known: tuple[str, ...] = (NOMINAL,)) -> None:
    """Raises UserError unless ``word`` is among the ``known`` ones, or a folder that holds a fit or an ensemble."""
    if word in known:
        return
    if not Path(word).is_dir():
        raise UserError(f"no model {str(word)!r} and no folder of one: {did_you_mean(str(word), known)}")
    if not holds_fit(word) and not (Path(word) / ENSEMBLE).exists():
        raise UserError(f"{word}: holds neither a fit ({SETTINGS}) nor an ensemble ({ENSEMBLE})")


def named_model(
    word: str | os.PathLike[str], task: Task, smoothing: Smoothing | None = None, threads: int | None = None
) -> ComplementarityModel | NeuralEnsemble:
    """``task``'s nominal model, or what the folder ``word`` holds; see ``saved_model``.

    Raises UserError when the folder holds no model, or one of another robot or control step.
    """
    if word == NOMINAL:
        return nominal_model(task, **_given(smoothing, threads))
    model = saved_model(word, smoothing, threads)
    scene = task.load_scene()
    owner = getattr(model, "layout", None) or model.scene  # type: ignore[union-attr]
    have, need = (owner.nq, owner.nv, owner.nu), (scene.nq, scene.nv, scene.nu)
    if have != need:
        raise UserError(f"{word}: is of another robot: nq, nv, nu {have}, task {task.name!r} has {need}")
    if abs(model.dt - task.control_dt) > 1e-6 * task.control_dt:
        raise UserError(f"{word}: steps {model.dt:g} s, task {task.name!r} {task.control_dt:g} s: fit on such a log")
    return model


def saved_model(
    folder: str | os.PathLike[str], smoothing: Smoothing | None = None, threads: int | None = None
) -> ComplementarityModel | NeuralEnsemble:
    """The model that ``folder`` holds; a fit with other smoothing or threads where given.

    Raises UserError when it holds none, and when an ensemble shall be smoothed.
    """
    check_name(folder)
    if holds_fit(folder):
        return load_complementarity(Path(folder) / SETTINGS).with_settings(**_given(smoothing, threads))
    if smoothing is not None:
        raise UserError(f"{folder}: an ensemble has no contacts to soften: leave the smoothing out")
    from cmbrl.models.ensemble import NeuralEnsemble

    return NeuralEnsemble.load(folder)


def _given(smoothing: Smoothing | None, threads: int | None) -> dict[str, Any]:
    chosen = {"smoothing": smoothing, "threads": threads}
    return {name: value for name, value in chosen.items() if value is not None}


def nominal_model(task: Task, scene: Scene | None = None, **options: Any) -> ComplementarityModel:
    """The model of the task's scene with its nominal parameters; ``options`` override the task's settings.

    ``scene``: the task's, where it is at hand or was read otherwise than the task says.
    """
    from cmbrl.contact.smoothing import Barrier
    from cmbrl.models.complementarity import ComplementarityModel

    settings = task.model_options() | {"smoothing": Barrier(task.smoothing_kappa)}
    return ComplementarityModel(scene or task.load_scene(), **(settings | options))


def load_complementarity(file: Path) -> ComplementarityModel:
    """The model that a ``model.json`` describes; raises UserError when it is damaged or its scene is gone."""
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.scene import Scene

    config = read_json(file)
    try:
        source, settings = config["scene"], config["settings"]
        scene = Scene.from_mjcf(
            source["path"],
            ignore=source["ignore"],
            contact_law=source["contact_law"],
            reduce=source.get("reduce", True),
        )
    except (KeyError, TypeError):
        raise UserError(f"{file}: damaged: fit again") from None
    return ComplementarityModel.from_config(scene, settings)
