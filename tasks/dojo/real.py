"""The real system of Dojo's robots: MuJoCo at 1 ms on the same file, with contacts as hard as it takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cmbrl.data.behaviour import controller
from cmbrl.data.transitions import Transitions
from cmbrl.envs.mdp import MDP
from cmbrl.envs.recording import Recording
from cmbrl.envs.system import MujocoSystem


def system(scene: Path) -> MujocoSystem:
    """A robot that takes 50 steps of MuJoCo per control step."""
    return MujocoSystem(scene, frame_skip=50)


def record(name: str, scene: Path, mdp: MDP, n_steps: int, seed: int, behaviour: Any, progress: Any) -> Transitions:
    """``n_steps`` transitions, every reset and termination starting a new episode; the same for the same seed.

    ``behaviour``: "random", "pd", or a policy from the process's observation (n_o,) to a control (nu,).
    """
    robot = Recording(mdp, lambda: system(scene), seed)
    model = robot.robot.systems[0].model  # type: ignore[attr-defined]
    control = controller(behaviour, model, np.random.default_rng([seed, 1]))
    for _ in range(n_steps):
        action = control(robot.observe()[0].numpy(), robot.q[0].numpy(), robot.v[0].numpy())
        robot.step(torch.from_numpy(np.asarray(action, dtype=np.float64))[None])
        if progress is not None:
            progress(1)
    kind = behaviour if isinstance(behaviour, str) else "policy"
    return replace(
        robot.log(),
        joint_names=tuple(model.joint(i).name for i in range(model.njnt)),
        actuator_names=tuple(model.actuator(i).name for i in range(model.nu)),
        source={"system": name, "behaviour": kind, "seed": seed},
    )
