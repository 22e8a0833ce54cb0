"""Tasks on Gymnasium's MuJoCo robots: file, logs and real system are found by the environment's id and asset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from cmbrl.registry import Task


def robot_task(
    name: str,
    environment: str,
    asset: str,
    frame_skip: int,
    *,
    recorded_steps: int = 1000,
    options: Mapping[str, Any] | None = None,
    feel: Callable[[Any, Any], Any] | None = None,
    **settings: Any,
) -> Task:
    """The task whose real system is Gymnasium's ``environment``; its process is ``mdp()`` of `cmbrl.tasks.NAME.mdp`.

    Args:
        name: of the task and of its module.
        environment: Gymnasium's id.
        asset: the MJCF, among Gymnasium's.
        frame_skip: steps of MuJoCo in a control step.
        recorded_steps: longest recorded episode, in control steps.
        options: of the environment, when a log is recorded.
        feel: what the real system tells besides its state: see :class:`cmbrl.system.MujocoSystem`.
        settings: the rest of the task.
    """

    def scene() -> Path:
        from cmbrl.data.recorder import gymnasium_asset

        return gymnasium_asset(asset)

    def record(**arguments: Any) -> Any:
        from cmbrl.data.recorder import record_gymnasium

        return record_gymnasium(environment, episode_steps=recorded_steps, options=options, **arguments)

    def mdp() -> Any:
        return import_module(f"cmbrl.tasks.{name}.mdp").mdp()

    def system() -> Any:
        from cmbrl.system import MujocoSystem

        return MujocoSystem(scene(), frame_skip=frame_skip, feel=feel)

    return Task(name=name, scene=scene, recorder=record, mdp=mdp, system=system, **settings)
