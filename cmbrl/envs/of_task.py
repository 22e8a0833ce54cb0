"""The decision process and the real system of a task, checked: not every task has them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cmbrl.errors import UserError, failure
from cmbrl.registry import load_task, names

if TYPE_CHECKING:
    from cmbrl.data.behaviour import PolicyFunction
    from cmbrl.data.transitions import Transitions
    from cmbrl.mdp import MDP
    from cmbrl.registry import Task
    from cmbrl.system import System, SystemFactory

Made = TypeVar("Made")


def decision_process(task: Task) -> MDP:
    """The task's decision process; raises UserError if it has none, one of another control step, or one that is wrong.

    What its functions return is tried on a few states (:mod:`cmbrl.envs.checked`), together and alone
    (:mod:`cmbrl.envs.checked_rows`).
    """
    from cmbrl.envs.checked import check_numbers, check_process
    from cmbrl.envs.checked_robot import check_widths
    from cmbrl.envs.checked_rows import check_rows

    if task.mdp is None:
        raise UserError(f"task {task.name!r} has no reward (Task.mdp); tasks with one: {_with_one() or 'none'}")
    mdp = made_process(task.mdp, f"task {task.name!r}: Task.mdp")
    check_numbers(mdp, f"task {task.name!r}")
    if abs(mdp.dt / mdp.repeat - task.control_dt) > 1e-6 * task.control_dt:
        raise UserError(
            f"task {task.name!r}: Task.mdp takes {mdp.repeat} model steps in {mdp.dt:g} s, but Task.control_dt is "
            f"{task.control_dt:g} s: fix dt, repeat or control_dt"
        )
    try:
        check_process(mdp, f"task {task.name!r}")
    except UserError:
        check_widths(mdp, task)  # starts of another width are the cause of what follows from them
        raise
    check_rows(mdp, f"task {task.name!r}")
    return mdp


def made_process(make: Callable[[], MDP], what: str) -> MDP:
    """What ``make`` gives; raises UserError, which begins with ``what``, where that fails or is no process."""
    from cmbrl.mdp import MDP

    if not callable(make):
        raise UserError(f"{what} is no function: give the function that makes the MDP")
    mdp = _made(make, what)
    if not isinstance(mdp, MDP):
        raise UserError(f"{what} gives {type(mdp).__name__}: return a cmbrl.mdp.MDP")
    return mdp


def _made(make: Callable[[], Made], what: str) -> Made:
    """What ``make``, foreign code, gives; raises UserError, which begins with ``what``, where it fails."""
    try:
        return make()
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{what} fails ({failure(error)}): mend it") from error


def trial_process(task: Task) -> MDP:
    """The process in which a policy of the task is judged: the task's own, unless evaluations start differently."""
    return decision_process(task) if task.trial is None else made_process(task.trial, f"task {task.name!r}: Task.trial")


def task_for(name: str, motion: str | Path | None, contact_law: str | None = None, sliding: str | None = None) -> Task:
    """The task called ``name``, for ``motion`` and with these laws of contact and sliding in its model, where given.

    Raises UserError for an unknown law, and for a motion if the task imitates none.
    """
    task = load_task(name)
    if motion is not None:
        if task.of_motion is None:
            raise UserError(f"--motion {motion}: task {name!r} imitates no motion: drop it")
        task = replace(task.of_motion(motion), name=task.name)  # a file's: by its place, so that it is found again
    if sliding is not None:
        task = replace(task, sliding=sliding)
    if contact_law is None:
        return task
    from cmbrl.scene.laws import LawChoice

    return replace(task, contact_law=str(LawChoice.parse(contact_law)))


def recorded(task: Task, behaviour: str | PolicyFunction | None = None) -> Task:
    """``task`` with a recorder: its own, or one that takes its real system through its process.

    The latter where a policy observes its last actions, which recorders of tasks do not tell.
    """
    from cmbrl.data.behaviour import last_actions_of

    processed = task.mdp is not None and task.system is not None
    own = task.recorder is not None and not (processed and last_actions_of(behaviour))
    return task if own else replace(task, recorder=partial(_record, task))


def _record(task: Task, **arguments: Any) -> Transitions:
    from cmbrl.envs.checked_robot import check_robot
    from cmbrl.envs.recording import record_process

    mdp = decision_process(task)
    check_robot(mdp, task)
    return record_process(mdp, real_system(task), **arguments)


def real_system(task: Task) -> SystemFactory:
    """The function that makes the task's real system.

    Raises UserError if it has none, and, when that is made, for one that cannot be made or has another control step.
    """
    make = task.system
    if make is None:
        raise UserError(f"task {task.name!r} has no real system (Task.system): use --model")

    def made() -> System:
        system = _made(make, f"task {task.name!r}: Task.system")
        if abs(system.dt - task.control_dt) > 1e-6 * task.control_dt:
            raise UserError(
                f"task {task.name!r}: a step of Task.system takes {system.dt:g} s, and Task.control_dt is "
                f"{task.control_dt:g} s: fix its frame_skip, or control_dt"
            )
        return system

    return made


def check_system(task: Task) -> None:
    """Raises UserError as :func:`real_system` does, before a training that needs no real system, where that is MuJoCo.

    Any other is left alone: a driver may take long to connect, and a robot should not move for a check.
    """
    if task.system is not None and _makes_mujoco(task.system):
        real_system(task)()


def _makes_mujoco(make: SystemFactory) -> bool:
    """Whether the code of ``make`` names :class:`MujocoSystem`, or a class of its module that is one."""
    from cmbrl.system import MujocoSystem

    code, known = getattr(make, "__code__", None), getattr(make, "__globals__", {})
    named = [] if code is None else code.co_names
    kinds = [known.get(name) for name in named]
    return MujocoSystem.__name__ in named or any(isinstance(x, type) and issubclass(x, MujocoSystem) for x in kinds)


def _with_one() -> str:
    """Names of the tasks that have a process; those that fail to load are left out."""
    found = []
    for name in names():
        with suppress(UserError):
            found += [name] if load_task(name).mdp is not None else []
    return ", ".join(found)
