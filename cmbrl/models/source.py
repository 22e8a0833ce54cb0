"""Scenes and logs by name: an MJCF file or a task, and the nominal model that steps it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmbrl.data.checks import TIME_STEP_TOLERANCE
from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.data.several import Log
    from cmbrl.data.transitions import Transitions
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.registry import Task
    from cmbrl.scene import Scene

POSITIONS_ONLY = "a log of positions without velocities: `fit` reads it, `error` with --open-loop"  #: elsewhere


@dataclass(frozen=True)
class Source:
    """A scene, and the task or the fitted model that defines its time stepping and laws of contact, if there is one."""

    word: str
    scene: Scene
    task: Task | None = None
    fitted: ComplementarityModel | None = None

    def model(self, data: Transitions | PositionLog | None = None, **options: Any) -> ComplementarityModel:
        """The model with nominal parameters, commands in time and encoders without bias.

        The substeps follow from the log's dt: those of a fit or a task go on as long as its control steps, so that a
        robot may be logged faster than a policy acts.

        ``options`` that are not None override the settings of the task or the fit.
        Raises UserError when the log's dt is not a whole number of the time steps in ``options``.
        """
        from cmbrl.models.complementarity import ComplementarityModel
        from cmbrl.models.named import nominal_model

        chosen = {name: value for name, value in options.items() if value is not None}
        if self.fitted is not None:
            own = {
                "scene": self.scene,
                "parameters": self.scene.parameter_vector(),
                "candidates": None,
                "observation": None,
            }
            if chosen.get("sliding", self.fitted.sliding) != self.fitted.sliding:
                own["look_ahead"] = None  # goes with the law
            model = self.fitted.with_settings(**{**own, **chosen})
            if data is None or abs(model.dt - data.dt) <= TIME_STEP_TOLERANCE * data.dt:
                return model
            return model.at(data.dt)
        if self.task is not None:
            nominal = nominal_model(self.task, self.scene, **chosen)
            if data is None or abs(nominal.dt - data.dt) <= TIME_STEP_TOLERANCE * data.dt:
                return nominal
            return nominal.at(data.dt)
        model = ComplementarityModel(self.scene, **chosen)
        return model if data is None else model.for_log(data.dt)


def load_source(
    word: str, ignore: Sequence[str] = (), contact_law: str | None = None, self_contact: str = "near"
) -> Source:
    """The scene of an MJCF or URDF file (a word that ends so, has a slash, or is a file) or of a task.

    Raises UserError on a missing file, an unknown task, and whatever the importer refuses.
    """
    from cmbrl.registry import is_task, load_task
    from cmbrl.scene import Scene

    path = Path(word)
    is_file = path.suffix.lower() in (".xml", ".mjcf", ".urdf") or "/" in word or os.path.isfile(path)
    task = load_task(word) if is_task(word) or not is_file else None
    law = contact_law or (task.contact_law if task else "mujoco")
    scene = Scene.from_mjcf(
        task.scene_path if task else word,
        ignore=ignore,
        contact_law=law,
        self_contact=self_contact,
        drives=task.drives if task else (),
    )
    return Source(word, scene, task=task)


def load_any_log(path: str, scene: Scene) -> Transitions | PositionLog:
    """The log in ``path``, of states or positions, checked against ``scene``; raises UserError that names the file."""
    from cmbrl.data import Transitions
    from cmbrl.data.npz import keys
    from cmbrl.data.position_file import is_layout
    from cmbrl.data.position_log import PositionLog
    from cmbrl.data.unlogged import with_columns

    data = PositionLog.load(path) if is_layout(keys(path)) else with_columns(Transitions.load(path), scene)
    try:
        data.check(scene)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return data


def load_logs(paths: Sequence[str], scene: Scene) -> dict[str, Log]:
    """The logs in ``paths`` by the names of their files, or by their paths where two have the same name."""
    names = [Path(path).name for path in paths]
    if twice := next((path for path in paths if list(paths).count(path) > 1), None):
        raise UserError(f"{twice}: given twice; give every log once")
    names = names if len(set(names)) == len(names) else list(paths)
    return {name: load_any_log(path, scene) for name, path in zip(names, paths, strict=True)}


def load_log(path: str, scene: Scene) -> Transitions:
    """The log of states in ``path``, checked against ``scene``; raises UserError that names the file."""
    from cmbrl.data import Transitions

    data = load_any_log(path, scene)
    if not isinstance(data, Transitions):
        raise UserError(f"{path}: {POSITIONS_ONLY}")
    return data
