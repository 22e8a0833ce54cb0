"""What a word on the command line stands for: a scene file or a task, a log, a model to compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.registry import Task
    from cmbrl.scene import Scene


@dataclass(frozen=True)
class Source:
    """A scene, and the task or the fitted model that says how to step it, where it came from one."""

    word: str
    scene: Scene
    task: Task | None = None
    fitted: ComplementarityModel | None = None

    def model(self, data: Transitions | None = None, **options: object) -> ComplementarityModel:
        """The nominal model; without a task the substeps follow from the log's dt and the scene's time step.

        ``options`` override what the source says where they are not None.
        Raises UserError when the log's dt is no whole number of time steps.
        """
        from cmbrl.models.complementarity import ComplementarityModel
        from cmbrl.models.named import nominal_model

        chosen = {name: value for name, value in options.items() if value is not None}
        if self.fitted is not None:
            return self.fitted.with_settings(parameters=self.scene.parameter_vector(), **chosen)
        if self.task is not None:
            return nominal_model(self.task, self.scene, **chosen)
        if data is not None:
            step = float(chosen.get("time_step", self.scene.timestep))  # type: ignore[arg-type]
            chosen = {"substeps": substeps(data.dt, step, self.word)} | chosen
        return ComplementarityModel(self.scene, **chosen)  # type: ignore[arg-type]


def substeps(dt: float, time_step: float, word: str) -> int:
    """How many physics steps [s] one transition of ``dt`` [s] takes."""
    count = round(dt / time_step)
    if count < 1 or abs(count * time_step - dt) > 1e-6 * dt:
        raise UserError(
            f"the log's dt {dt:g} s is no whole number of time steps {time_step:g} s of {word}: give --time-step"
        )
    return count


def load_log(path: str, scene: Scene) -> Transitions:
    """The log in ``path``, checked against ``scene``; raises UserError that names the file."""
    from cmbrl.data import Transitions

    data = Transitions.load(path)
    try:
        data.check(scene)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return data


def load_source(word: str, ignore: Sequence[str] = (), contact_law: str | None = None) -> Source:
    """The scene of an MJCF file (anything that ends in .xml, has a slash, or is a file) or of a registered task.

    Raises UserError: no such file, unknown task (with the nearest name), or whatever the importer refuses.
    """
    from cmbrl.registry import load_task
    from cmbrl.scene import Scene

    path = Path(word)
    is_file = path.suffix.lower() in (".xml", ".mjcf") or "/" in word or path.is_file()
    task = None if is_file else load_task(word)
    law = contact_law or (task.contact_law if task else "mujoco")
    scene = Scene.from_mjcf(task.scene_path if task else word, ignore=ignore, contact_law=law)
    return Source(word, scene, task=task)
