"""What a word on the command line stands for: a scene file or a task, a log, a model to compare."""

from __future__ import annotations

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
    """A scene, and the task it came from where a task was named."""

    word: str
    scene: Scene
    task: Task | None

    def model(self, data: Transitions | None = None, **options: object) -> ComplementarityModel:
        """The nominal model; without a task the substeps follow from the log's dt and the scene's time step.

        ``options`` override the task's or the scene's choice where they are not None.
        Raises UserError when the log's dt is no whole number of time steps.
        """
        from cmbrl.models.complementarity import ComplementarityModel

        chosen = {name: value for name, value in options.items() if value is not None}
        if self.task is not None:
            settings = self.task.model_options()
        elif data is not None:
            step = float(chosen.get("time_step", self.scene.timestep))  # type: ignore[arg-type]
            settings = {"substeps": substeps(data.dt, step, self.word)}
        else:
            settings = {}
        return ComplementarityModel(self.scene, **(settings | chosen))


def substeps(dt: float, time_step: float, word: str) -> int:
    """How many physics steps [s] one transition of ``dt`` [s] takes."""
    count = round(dt / time_step)
    if count < 1 or abs(count * time_step - dt) > 1e-6 * dt:
        raise UserError(
            f"the log's dt {dt:g} s is no whole number of time steps {time_step:g} s of {word}: give --time-step"
        )
    return count


def load_source(word: str, ignore: list[str]) -> Source:
    """The scene of an MJCF file (anything that ends in .xml, has a slash, or exists) or of a registered task.

    Raises UserError: no such file, unknown task (with the nearest name), or whatever the importer refuses.
    """
    from cmbrl.scene import Scene

    path = Path(word)
    if path.suffix.lower() in (".xml", ".mjcf") or "/" in word or path.exists():
        return Source(word, Scene.from_mjcf(word, ignore=tuple(ignore)), None)
    from cmbrl.registry import load_task

    task = load_task(word)
    return Source(word, Scene.from_mjcf(task.scene_path, ignore=tuple(ignore)), task)
