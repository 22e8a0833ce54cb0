"""A trained policy in its folder, with its task and the model to try it in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cmbrl.envs.of_task import task_for, trial_process
from cmbrl.errors import UserError
from cmbrl.files import file_digest
from cmbrl.mdp import MDP
from cmbrl.registry import Task
from cmbrl.train.models import REAL, check_model
from cmbrl.train.policies.file import SavedPolicy, load_policy
from cmbrl.train.policies.policy import observed_by


def check_motion(folder: str | Path, about: Mapping[str, Any]) -> None:
    """Raises UserError where the motion that the run in ``folder`` imitates is not what it was, by its ``about``."""
    motion = about.get("motion")
    if motion is not None and file_digest(motion) != about.get("motion_digest"):
        raise UserError(f"{motion}: has changed since {folder} was trained on it: restore it, or train again")


def _check_robot(folder: str, trained: Task, other: Task) -> None:
    """Raises UserError unless both tasks are of robots with the same coordinates and actuators."""
    of = [(scene.coordinate_names, scene.actuator_names) for scene in (trained.load_scene(), other.load_scene())]
    if of[0] != of[1]:
        raise UserError(
            f"--task {other.name}: has other joints or actuators than the robot that {folder} was trained for, "
            f"{trained.name}: name a task of that robot"
        )


@dataclass(frozen=True)
class Trained:
    """A policy from ``folder``, the task that it was trained for, and the process that it is judged in."""

    folder: Path
    saved: SavedPolicy
    task: Task
    mdp: MDP

    @classmethod
    def load(cls, folder: str, task_name: str | None = None) -> Trained:
        """The policy, to be judged in its task or in that of ``task_name``, as another real system of the same robot.

        Raises UserError when the folder holds no policy, or one that does not fit the task.
        """
        saved = load_policy(folder)
        laws = saved.about.get("motion"), saved.about.get("contact_law"), saved.about.get("sliding")
        task = task_for(task_name or saved.task, *laws)
        if task_name is not None:
            _check_robot(folder, task_for(saved.task, *laws), task)
        check_motion(folder, saved.about)
        mdp = observed_by(saved.policy, trial_process(task))
        shape = saved.policy.architecture
        have, need = (shape.observations, shape.actions), (mdp.observations, mdp.actions)
        if have != need:
            remedy = "train again" if task_name is None else "name a task that has the same"
            raise UserError(
                f"{folder}: takes {have[0]} observations and gives {have[1]} actions, but task {task.name!r} has "
                f"{need[0]} and {need[1]}: {remedy}"
            )
        return cls(Path(folder), saved, task, mdp)

    def usual_model(self) -> str | None:
        """The name of the model it was trained on, or fitted as it trained; None for the real system or an unknown one.

        Raises UserError when that model is missing.
        """
        fitted = self.folder / "fit"
        word = str(fitted) if fitted.is_dir() else self.saved.about.get("model")
        if word is None or word == REAL:
            return None
        check_model(word)
        return word
