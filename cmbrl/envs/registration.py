"""Tasks with a decision process as Gymnasium ids: ``cmbrl/Hopper-v0`` on a model, ``cmbrl/HopperReal-v0`` in reality.

Gymnasium 1.x does not load plugins: import this module, or name it in the id.

>>> import gymnasium, cmbrl.envs.registration
>>> env = gymnasium.make("cmbrl/Hopper-v0", model="runs/hopper/fit", render_mode="rgb_array")  # default "nominal"
>>> envs = gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=64)                              # autoreset in the same step
>>> env = gymnasium.make("cmbrl.envs.registration:cmbrl/HopperReal-v0")
"""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from typing import Any

from cmbrl.envs.gymnasium_env import MDPEnv
from cmbrl.envs.history import MOST, with_last_actions
from cmbrl.envs.of_task import decision_process, real_system
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.envs.vector_env import MDPVectorEnv
from cmbrl.errors import MissingPackage, UserError
from cmbrl.mdp import MDP
from cmbrl.models.named import NOMINAL, named_model
from cmbrl.models.protocol import Model
from cmbrl.numbers import whole
from cmbrl.registry import Task, load_task, names

try:
    import gymnasium
except ImportError:
    raise UserError("gymnasium is not installed: pip install 'cmbrl[tasks]'") from None


def make_model(
    task: str, model: str | os.PathLike[str] | Model = NOMINAL, last_actions: int = 0, **options: Any
) -> MDPEnv:
    """``task`` on its nominal model, on the model in a folder, or on a given model; ``options`` are MDPEnv's.

    A fit's delay and lag of commands act in its model; ``last_actions`` of them are put at the end of observations.
    """
    known = load_task(task)
    return MDPEnv(_process(known, last_actions=last_actions), _model(model, known), known.scene_path, **options)


def make_real(task: str, last_actions: int = 0, **options: Any) -> MDPEnv:
    """``task`` in its real system; ``last_actions`` as above, ``options`` are MDPEnv's."""
    known = load_task(task)
    return MDPEnv(
        _process(known, last_actions=last_actions), SystemBatch(real_system(known), 1), known.scene_path, **options
    )


def make_model_vector(
    task: str,
    num_envs: int = 1,
    model: str | os.PathLike[str] | Model = NOMINAL,
    max_episode_steps: int | None = None,
    last_actions: int = 0,
    **options: Any,
) -> MDPVectorEnv:
    """``num_envs`` episodes of ``task`` on a model, all in one native call; ``options`` are MDPVectorEnv's."""
    known = load_task(task)
    mdp = _process(known, max_episode_steps, last_actions)
    return MDPVectorEnv(Simulation(mdp, _model(model, known), num_envs, tell=True), known.scene_path, **options)


def make_real_vector(
    task: str,
    num_envs: int = 1,
    max_episode_steps: int | None = None,
    last_actions: int = 0,
    **options: Any,
) -> MDPVectorEnv:
    """``num_envs`` episodes of ``task``, each in its own real system; ``options`` are MDPVectorEnv's."""
    known = load_task(task)
    mdp, systems = _process(known, max_episode_steps, last_actions), SystemBatch(real_system(known), num_envs)
    return MDPVectorEnv(Simulation(mdp, systems, num_envs, tell=True), known.scene_path, **options)


def register(task: Task) -> list[str]:
    """Registers the ids of a task with Gymnasium, and returns them: none without an MDP, no Real without a system."""
    if task.mdp is None:
        return []
    here, stem = __name__, "cmbrl/" + "".join(word.capitalize() for word in task.name.split("_"))
    entries = {f"{stem}-v0": ("make_model", "make_model_vector")}
    if task.system is not None:
        entries[f"{stem}Real-v0"] = ("make_real", "make_real_vector")
    limit = task.mdp().episode_steps
    for name, (single, vector) in entries.items():
        gymnasium.register(
            id=name,
            entry_point=f"{here}:{single}",
            vector_entry_point=f"{here}:{vector}",
            max_episode_steps=limit,
            kwargs={"task": task.name},
        )
    return list(entries)


def register_all() -> list[str]:
    """Registers all installed tasks and returns their ids; a task that fails to load is left out with a warning.

    One whose optional package is not installed is left out without a word.
    """
    found = []
    for name in names():
        try:
            found += register(load_task(name))
        except MissingPackage:
            continue
        except Exception as error:  # a task is foreign code: one that is broken must not take the others with it
            told = str(error) if isinstance(error, UserError) else f"task {name!r} fails ({error!r})"
            warnings.warn(f"no environment for {name}: {told}", stacklevel=2)
    return found


def _process(task: Task, episode_steps: int | None = None, last_actions: int = 0) -> MDP:
    """The task's decision process without shaping, which environments never report; with a shorter limit if given."""
    mdp = with_last_actions(decision_process(task), whole(last_actions, "last_actions", least=0, most=MOST))
    limit = mdp.episode_steps if episode_steps is None else min(mdp.episode_steps, episode_steps)
    return replace(mdp, shaping=None, episode_steps=limit)


def _model(model: str | os.PathLike[str] | Model, task: Task) -> Model:
    return named_model(model, task) if isinstance(model, (str, os.PathLike)) else model


IDS = register_all()
"""The ids of all installed tasks. For a task of this process only, call ``register(task)``."""
