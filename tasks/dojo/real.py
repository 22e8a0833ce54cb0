"""The real system of Dojo's robots: MuJoCo at 1 ms on the same file, with its hardest contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.data.transitions import Transitions
from cmbrl.envs.mujoco_recording import record_mujoco
from cmbrl.mdp import MDP
from cmbrl.system import MujocoSystem


def system(scene: Path) -> MujocoSystem:
    """One robot that takes 50 steps of MuJoCo per control step."""
    return MujocoSystem(scene, frame_skip=50)


def record(name: str, scene: Path, mdp: MDP, **arguments: Any) -> Transitions:
    """Transitions of the robot in the process ``mdp``; ``arguments`` as in `cmbrl.registry.Task.record`."""
    return record_mujoco(name, mdp, lambda: system(scene), **arguments)
