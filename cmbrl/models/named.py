"""Models by name: "nominal", a task's scene as its file has it, or a folder that holds a fit or an ensemble."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from cmbrl.contact.smoothing import Barrier
from cmbrl.errors import UserError
from cmbrl.files import read_json
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.ensemble import DESCRIPTION, NeuralEnsemble
from cmbrl.registry import Task
from cmbrl.scene import Scene

NOMINAL = "nominal"
SETTINGS = "model.json"  #: in the folder of a fit: the scene and how the model steps it


def named_model(word: str | os.PathLike[str], task: Task) -> ComplementarityModel | NeuralEnsemble:
    """``task``'s nominal model, or what the folder ``word`` holds.

    Raises UserError when the folder holds no model, or one of another robot or control step.
    """
    if word == NOMINAL:
        return nominal_model(task)
    if (Path(word) / SETTINGS).exists():
        model: ComplementarityModel | NeuralEnsemble = load_complementarity(Path(word) / SETTINGS)
    elif (Path(word) / DESCRIPTION).exists():
        model = NeuralEnsemble.load(word)
    else:
        raise UserError(f"{word}: neither {NOMINAL!r} nor a folder that holds a fit ({SETTINGS}) or an ensemble")
    scene = task.load_scene()
    owner = model.scene if isinstance(model, ComplementarityModel) else model.layout
    have, need = (owner.nq, owner.nv, owner.nu), (scene.nq, scene.nv, scene.nu)
    if have != need:
        raise UserError(f"{word}: is of another robot: nq, nv, nu {have}, task {task.name!r} has {need}")
    if abs(model.dt - task.control_dt) > 1e-6 * task.control_dt:
        raise UserError(f"{word}: steps {model.dt:g} s, task {task.name!r} {task.control_dt:g} s: fit on such a log")
    return model


def nominal_model(task: Task, **options: Any) -> ComplementarityModel:
    """The model of the task's scene with its nominal parameters; ``options`` override the task's settings."""
    settings = task.model_options() | {"smoothing": Barrier(task.smoothing_kappa)}
    return ComplementarityModel(task.load_scene(), **(settings | options))


def load_complementarity(file: Path) -> ComplementarityModel:
    """The model that a ``model.json`` describes; raises UserError when it is damaged or its scene is gone."""
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
