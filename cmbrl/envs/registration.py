"""Tasks with a decision process as Gymnasium ids: ``cmbrl/Hopper-v0`` on a model, ``cmbrl/HopperReal-v0`` in reality.

Gymnasium 1.x looks for no plugins: import this module, or name it in the id.

>>> import gymnasium, cmbrl.envs.registration
>>> env = gymnasium.make("cmbrl/Hopper-v0", model="runs/hopper/fit", render_mode="rgb_array")  # default "nominal"
>>> envs = gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=64)                              # autoreset in the same step
>>> env = gymnasium.make("cmbrl.envs.registration:cmbrl/HopperReal-v0")
"""

from __future__ import annotations

import os
from typing import Any

from cmbrl.envs.gymnasium_env import MDPEnv
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.envs.vector_env import MDPVectorEnv
from cmbrl.errors import UserError
from cmbrl.models.named import NOMINAL, named_model
from cmbrl.models.protocol import Model
from cmbrl.registry import Task, load_task, names

try:
    import gymnasium
except ImportError:
    raise UserError("gymnasium is not installed: pip install 'cmbrl[tasks]'") from None


def make_model(task: str, model: str | os.PathLike[str] | Model = NOMINAL, **options: Any) -> MDPEnv:
    """``task`` on its nominal model, on what a folder holds, or on a model that is given; options of MDPEnv."""
    known = load_task(task)
    assert known.mdp is not None
    return MDPEnv(known.mdp(), _model(model, known), known.scene_path, **options)


def make_real(task: str, **options: Any) -> MDPEnv:
    """``task`` in its real system; options of MDPEnv."""
    known = load_task(task)
    assert known.mdp is not None
    assert known.system is not None
    return MDPEnv(known.mdp(), SystemBatch(known.system, 1), known.scene_path, **options)


def make_model_vector(
    task: str, num_envs: int = 1, model: str | os.PathLike[str] | Model = NOMINAL, render_mode: None = None
) -> MDPVectorEnv:
    """``num_envs`` episodes of ``task`` on a model, all in one native call."""
    known = load_task(task)
    assert known.mdp is not None
    return MDPVectorEnv(Simulation(known.mdp(), _model(model, known), num_envs))


def make_real_vector(task: str, num_envs: int = 1, render_mode: None = None) -> MDPVectorEnv:
    """``num_envs`` episodes of ``task``, each in a real system of its own."""
    known = load_task(task)
    assert known.mdp is not None
    assert known.system is not None
    return MDPVectorEnv(Simulation(known.mdp(), SystemBatch(known.system, num_envs), num_envs))


def register(task: Task) -> list[str]:
    """Makes the ids of a task known to Gymnasium, and returns them: none without an MDP, no Real without a system."""
    if task.mdp is None:
        return []
    here, stem = __name__, "cmbrl/" + "".join(word.capitalize() for word in task.name.split("_"))
    entries = {f"{stem}-v0": ("make_model", "make_model_vector")}
    if task.system is not None:
        entries[f"{stem}Real-v0"] = ("make_real", "make_real_vector")
    for name, (single, vector) in entries.items():
        gymnasium.register(
            id=name,
            entry_point=f"{here}:{single}",
            vector_entry_point=f"{here}:{vector}",
            kwargs={"task": task.name},
        )
    return list(entries)


def _model(model: str | os.PathLike[str] | Model, task: Task) -> Model:
    return named_model(model, task) if isinstance(model, (str, os.PathLike)) else model


IDS = [name for task in names() for name in register(load_task(task))]
"""The ids of all installed tasks. A task of this process only: ``register(task)``."""
