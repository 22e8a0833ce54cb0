"""A task whose real system is a draw of a family of hidden systems: ``walker2d@payload:3``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean

if TYPE_CHECKING:
    from cmbrl.registry import Task
    from cmbrl.system import MujocoSystem, System

PARAMETERS, PAYLOAD, FLOOR, OUTSIDE = "parameters", "payload", "floor", "outside"
FAMILIES = (PARAMETERS, PAYLOAD, FLOOR, OUTSIDE)
DRAW_SEED = 16  #: of the hidden systems
MOST = 2**31  #: of draws


def hidden_task(task: Task, which: str) -> Task:
    """``task`` whose real system is ``which``, FAMILY:DRAW; models of it still start from its file.

    Raises UserError for an unknown family or draw, and, here or where a robot is made, for a task whose real system is
    not MuJoCo on a file.
    """
    name, (family, draw) = f"{task.name}@{which}", _parsed(task.name, which)
    if task.of_motion is None and task.system is None:
        raise UserError(f"{name}: the task has no real system that can be changed (Task.system): drop @{which}")
    return replace(
        task,
        name=name,
        description=f"{task.description}; hidden robot: {family}, draw {draw}",
        system=None if task.system is None else _maker(task, name, family, draw),
        of_motion=None if task.of_motion is None else partial(_of_motion, task, which),
        recorder=None if task.mdp is not None and task.system is not None else task.recorder,
    )


def _of_motion(task: Task, which: str, motion: Any) -> Task:
    assert task.of_motion is not None
    return hidden_task(task.of_motion(motion), which)


def _parsed(task: str, which: str) -> tuple[str, int]:
    family, _, draw = which.partition(":")
    if family not in FAMILIES:
        raise UserError(
            f"{task}@{which}: unknown family of hidden systems {family!r}: {did_you_mean(family, FAMILIES)}"
        )
    if not (draw.isascii() and draw.isdigit() and int(draw) < MOST):
        raise UserError(f"{task}@{which}: name a draw, a whole number from 0 to {MOST - 1}, as {task}@{family}:0")
    return family, int(draw)


def _maker(task: Task, name: str, family: str, draw: int) -> Callable[[], System]:
    """Makes robots of one draw, each with noise of its own, on one compiled model."""
    parts = count(2)  # of the draw's random numbers
    made = cache(partial(_compiled, task, name, family, draw))

    def make() -> System:
        from cmbrl.hidden.system import HiddenSystem

        model, flaws, joints, dt, feel = made()
        return HiddenSystem(model, dt, joints, flaws, generator(family, draw, next(parts)), feel)

    return make


def generator(family: str, draw: int, part: int = 0) -> np.random.Generator:
    """Of one part of one draw; draws do not depend on each other, nor on the robot's name."""
    return np.random.default_rng([DRAW_SEED, FAMILIES.index(family), draw, part])


def _compiled(task: Task, name: str, family: str, draw: int) -> tuple[Any, Any, list[int], float, Any]:
    """The model, its flaws, the file's joints in it, the control step [s], and what it tells besides its state."""
    from cmbrl.hidden import changes, flaws
    from cmbrl.system import MujocoSystem

    assert task.system is not None
    own = task.system()
    if type(own) is not MujocoSystem:
        kind = type(own).__name__
        raise UserError(f"{name}: the real system is a {kind}, which only its maker can change: drop @{family}:{draw}")
    kinds = {PARAMETERS: changes.parameters, PAYLOAD: changes.payload, FLOOR: changes.floor}
    changed = own.altered(partial(kinds.get(family, changes.friction_loss), rng=generator(family, draw)))
    if family != OUTSIDE:
        return changed.model, flaws.Flaws(), list(range(changed.model.njnt)), own.dt, own.feel
    _check_unchanged(own, name)
    model, found = flaws.flawed(own.path, changed.model, own.dt, generator(family, draw, 1), own.drives)
    joints = [k for k in range(model.njnt) if not _is_added(model, changed.model, k)]
    return model, found, joints, own.dt, own.feel


def _check_unchanged(own: MujocoSystem, name: str) -> None:
    if own.change is not None:
        raise UserError(
            f"{name}: the task's real system differs from its file already, and joints for backlash would move the "
            f"places that it changes: choose {PARAMETERS}, {PAYLOAD} or {FLOOR}"
        )


def _is_added(model: Any, file_like: Any, joint: int) -> bool:
    import mujoco

    return mujoco.mj_name2id(file_like, mujoco.mjtObj.mjOBJ_JOINT, model.joint(joint).name) < 0 and bool(
        model.joint(joint).name
    )
